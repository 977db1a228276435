"""The family of a lot's maps is a choice of whoever calibrates: command, lot.toml, page, REST; kept with the lot."""

import json
import re
import shutil

import pytest

from softcal.app.cli.main import main
from softcal.app.jobs.jobs import run_job
from softcal.core.maps.catalogue import BUILTIN_FAMILIES
from softcal.db.connection import open_registry


@pytest.fixture
def lot(trained_lot, tmp_path):
    shutil.copytree(trained_lot / "lot", tmp_path / "lot")
    shutil.copy(trained_lot / "registry.db", tmp_path / "r.db")
    return tmp_path


def batch(lot, *more: str) -> dict[str, dict[str, object]]:
    url = f"sqlite:///{lot / 'r.db'}"
    report = lot / "report.json"
    code = main(
        ["batch", str(lot / "lot"), "--registry", url, "--hidden", "16,8", "--no-own", *more, "--json", str(report)]
    )
    assert code in (0, 1)
    return {unit["serial"]: unit for unit in json.loads(report.read_text())["units"]}


def families(units) -> set[str]:
    return {unit["map"]["family"] for unit in units.values()}


def is_stale(lot) -> bool:
    with open_registry(f"sqlite:///{lot / 'r.db'}") as registry:
        return any(unit.is_stale for unit in registry.lots.units("small") if unit.role == "target")


def test_a_family_is_chosen_at_the_command_and_has_verdicts_and_files(lot):
    family = "exact"
    usual = batch(lot)
    chosen = batch(lot, "--map", family, "--release", "conditional", "--out", str(lot / "out"))
    assert families(chosen) == {family}
    for serial, unit in chosen.items():
        assert unit["verdict"] in ("pass", "conditional", "fail", "retest") and unit["predicted_rmse"] > 0
        assert unit["method"] != usual[serial]["method"]
        assert any((lot / "out").glob(f"unit-{serial}.json")) == (unit["verdict"] in ("pass", "conditional"))
    # It is this version's method: nothing is to be made anew.
    assert not is_stale(lot)
    # The choice belongs to the lot until it is taken back; the earlier results are found again, not made again.
    assert families(batch(lot)) == {family}
    again = batch(lot, "--map", "auto")
    assert {s: u["map"]["sha256"] for s, u in again.items()} == {s: u["map"]["sha256"] for s, u in usual.items()}


def test_lot_toml_states_it_and_the_command_outranks_it(lot):
    toml = lot / "lot/lot.toml"
    toml.write_text(toml.read_text() + '[map]\nfamily = "monotone"\n')
    assert families(batch(lot)) == {"monotone"}
    assert families(batch(lot, "--map", "affine")) == {"affine"}


@pytest.mark.parametrize("options", ['"optimal"', "3", "true"])
def test_a_family_that_there_is_not_is_refused_in_one_line(lot, capsys, options):
    toml = lot / "lot/lot.toml"
    toml.write_text(toml.read_text() + f"[map]\nfamily = {options}\n")
    assert main(["batch", str(lot / "lot"), "--registry", f"sqlite:///{lot / 'r.db'}"]) == 2
    assert "lot.toml" in capsys.readouterr().err
    if options.startswith('"'):
        assert main(["batch", str(lot / "lot"), "--map", "optimal", "--registry", f"sqlite:///{lot / 'r.db'}"]) == 2
        assert "exact" in capsys.readouterr().err


def test_the_help_names_every_family_that_is_built_in(capsys):
    with pytest.raises(SystemExit):
        main(["batch", "--help"])
    help_words = set(re.findall(r"[a-z_]+", capsys.readouterr().out))
    assert {"auto", *BUILTIN_FAMILIES} <= help_words


def test_a_job_takes_it_and_the_line_maps_by_it(lot, monkeypatch):
    from softcal.app.calibration.lot_context import lot_method

    monkeypatch.setenv("SOFTCAL_DATA_FOLDER", str(lot / "data"))
    batch(lot)
    with open_registry(f"sqlite:///{lot / 'r.db'}") as registry:
        job = registry.job_board.place("calibrate", {"lot": "small", "map": "two_point"}, "Erin", None)
        assert run_job(registry, job, lambda: None) == "done"
        fits = [
            registry.calibrations.get(u.serial, lot_id="small").state.fit
            for u in registry.lots.units("small")
            if u.role == "target"
        ]
        assert {fit.family for fit in fits} == {"two_point"}
        assert {fit.method.id for fit in fits} == {lot_method(registry, "small").id}
