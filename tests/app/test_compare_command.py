"""`softcal compare` puts map families side by side on a lot at hand and stores nothing."""

import json

import pytest

from softcal.app.cli.main import main
from softcal.db.connection import open_registry


def test_families_side_by_side_and_the_registry_as_it_was(calibrated, capsys):
    def contents():
        with open_registry(calibrated) as registry:
            return [(u.serial, u.family, u.revision) for u in registry.lots.units("small")], registry.trail.rows()

    before = contents()
    command = ["compare", "small", "--registry", calibrated, "--maps", "auto,two_point,auto,exact", "--json", "-"]
    assert not main(command)
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [row["family"] for row in rows] == ["auto", "two_point", "exact"]
    assert all(row["after"] < row["before"] and row["audited"] == 3 for row in rows)
    assert contents() == before


@pytest.mark.parametrize("wrong", [("small", "--maps", "optimal"), ("nolot",), ("small", "--network", "ab")])
def test_what_there_is_not_is_one_line(calibrated, capsys, wrong):
    assert main(["compare", *wrong, "--registry", calibrated]) == 2
    assert "Traceback" not in capsys.readouterr().err
