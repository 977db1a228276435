"""`softcal lot`: a limit has a version and a reason, and so have the rules of a lot at the line."""

import json

import pytest

from softcal.app.cli.main import main
from softcal.core.lot import Lot
from softcal.db.connection import open_registry


@pytest.fixture
def known_lot(tmp_path):
    url = f"sqlite:///{tmp_path / 'r.db'}"
    with open_registry(url) as registry:
        registry.lots.add(Lot("L1", "S0", 50.0, limit_rmse=0.2))
    return url


def test_a_limit_needs_a_reason_and_keeps_its_versions(known_lot, capsys):
    common = ["lot", "limit", "L1", "--registry", known_lot]
    assert main([*common, "--rmse", "0.1"]) == 2 and "--reason" in capsys.readouterr().err
    assert main([*common, "--rmse", "0.1", "--reason", "drawing C", "--json", "-"]) == 0
    versions = json.loads(capsys.readouterr().out)["versions"]
    assert [(v["version"], v["rmse"]) for v in versions] == [(1, 0.2), (2, 0.1)]
    assert main([*common, "--rmse", "0.3", "--reason", "late", "--expect", "1"]) == 2
    assert "0.1" in capsys.readouterr().err


def test_rules_of_a_lot_are_set_with_a_reason_and_shown_with_their_versions(known_lot, capsys):
    change = ["--target", "6", "--retests", "fail=0", "--reason", "customer allows no second try"]
    assert main(["lot", "rules", "L1", "--registry", known_lot, *change, "--json", "-"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert (shown["now"]["target"], shown["now"]["retests"]["fail"], shown["now"]["retests"]["retest"]) == (6, 0, 3)
    assert [entry["reason"] for entry in shown["versions"]] == ["customer allows no second try"]


@pytest.mark.parametrize(
    "wrong", [["--target", "6"], ["--retests", "fail=x", "--reason", "why"], ["--serial-pattern", "A["]]
)
def test_senseless_rules_of_a_lot_change_nothing(known_lot, wrong):
    assert main(["lot", "rules", "L1", "--registry", known_lot, *wrong]) == 2
    with open_registry(known_lot) as registry:
        assert registry.lots.line_rules_versions("L1") == []
