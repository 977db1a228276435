"""The fit of a lot as an act: by batch or person, previewed, numbered, stored, taken back, and said of every map."""

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from fastapi.testclient import TestClient

import softcal
from softcal.app.calibration.lot_decision import decision_in_force
from softcal.app.calibration.lot_fit import make_lot_fit, open_lot_fit, plan_lot_fit
from softcal.app.cli.main import main
from softcal.app.registry.lot_recordings import newest_audits
from softcal.app.rest.server import rest_app
from softcal.core.maps.interface import map_sha256
from softcal.core.metrics import rmse
from softcal.core.recording import OutputRecording
from softcal.core.unit.estimate import estimate
from softcal.db.connection import open_registry
from softcal.db.registry import Registry
from tests.presses import dwelling_presses

RATE_HZ, UNITS = 50.0, [f"U{k}" for k in range(1, 7)]
NETWORK = ("--hidden", "16,8", "--no-own")


def recorded(force_N: np.ndarray, seed: int) -> pd.DataFrame:
    unit_rng = np.random.default_rng([seed, 7])
    gain, rest, curvature = unit_rng.uniform(0.8, 1.2), unit_rng.uniform(0.4, 0.6), unit_rng.uniform(0.0, 0.02)
    noise = np.random.default_rng([seed, len(force_N)]).normal(0, 0.0005, len(force_N))
    output = rest + gain * (0.1 * force_N + curvature * force_N**2) + noise
    return pd.DataFrame({"t_s": np.arange(len(output)) / RATE_HZ, "output": output, "reference": force_N})


def press(folder: Path, serial: str, force_N: np.ndarray) -> None:
    """Press a unit and put its output into the lot folder."""
    recorded(force_N, int(serial[1:]))[["t_s", "output"]].to_csv(folder / f"units/{serial}.csv", index=False)


TOGETHER_N = dwelling_presses(9, 2500, 60.0)
"""What the units are pressed with at once: held much longer than the source was."""


@pytest.fixture(scope="module")
def pressed_lot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lot whose units were pressed together under a programme that the source did not have, and its registry."""
    root = tmp_path_factory.mktemp("shared")
    folder = root / "lot"
    for name in ("source", "units", "audit"):
        (folder / name).mkdir(parents=True)
    (folder / "lot.toml").write_text(
        'sample_rate_Hz = 50.0\nsource = "S0"\n[lot]\nid = "tuesday"\nsimulated = true\n[reference]\nunit = "N"\n'
        '[output]\nunit = "V"\n[limit]\nrmse = 0.4\n'
    )
    recorded(dwelling_presses(1, 4000, 2.0), 0).to_csv(folder / "source/S0.csv", index=False)
    for serial in UNITS:
        press(folder, serial, TOGETHER_N)
    main(["batch", str(folder), "--registry", f"sqlite:///{root / 'r.db'}", *NETWORK, "--json", str(root / "b.json")])
    return root


@pytest.fixture
def lot(pressed_lot: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(pressed_lot, tmp_path / "copy"))


@pytest.fixture
def registry(lot: Path) -> Iterator[Registry]:
    with open_registry(f"sqlite:///{lot / 'r.db'}") as registry:
        yield registry


@pytest.fixture
def run(lot: Path) -> Callable[..., int]:
    return lambda *command: main([*command, "--registry", f"sqlite:///{lot / 'r.db'}"])


@pytest.fixture
def batch(lot: Path, run: Callable[..., int]) -> Callable[..., dict]:
    def again(*more: str) -> dict:
        assert run("batch", str(lot / "lot"), *NETWORK, "--json", str(lot / "b.json"), *more) in (0, 1)
        return json.loads((lot / "b.json").read_text())

    return again


def maps(registry: Registry) -> dict[str, str]:
    return {s: registry.calibrations.get(s, lot_id="tuesday").state.map_sha256 for s in UNITS}


def test_a_batch_makes_it_and_every_surface_says_which_one_a_map_comes_from(lot, registry, run, capsys, add_everybody):
    report = json.loads((lot / "b.json").read_text())
    for unit in report["units"]:
        part = unit["map"]["lot_fit"]
        assert unit["map"]["family"] == "shared_load" and part["number"] == 1 and part["units"] == 6
        assert part["common_rmse"] > 0 and part["unit_rmse"] > 0
        assert any("lot fit 1" in why for why in unit["reasons"])
    assert report["lot_fit"]["number"] == 1 and sorted(report["lot_fit"]["units"]) == UNITS
    assert decision_in_force(registry, "tuesday").fit.sittings == (tuple(UNITS),)
    run("registry", "history", "--serial", "U3", "--json", "-")
    alone, fitted = json.loads(capsys.readouterr().out)["revisions"][:2]
    assert alone["fit"]["lot_fit"] is None and fitted["fit"]["lot_fit"]["number"] == 1
    assert fitted["reason"] == "lot fit 1"
    add_everybody(f"sqlite:///{lot / 'r.db'}")
    secret = registry.tokens.add("Erin", "a test", 1)[1]
    client = TestClient(rest_app(registry), headers={"Authorization": f"Bearer {secret}"})
    served = client.get("/v1/lots/tuesday/units/U3/revisions").json()["revisions"]
    (current,) = [one for one in served if one["is_current"]]
    assert current["fit"]["lot_fit"]["number"] == 1 and any("lot fit 1" in why for why in current["reasons"])


def test_python_gives_the_same_maps_to_the_digit(lot, registry):
    source = pd.read_csv(lot / "lot/source/S0.csv")
    units = {serial: pd.read_csv(lot / f"lot/units/{serial}.csv") for serial in UNITS}
    network = softcal.fit_network(source, hidden=(16, 8), serial="S0")
    fit = softcal.fit_lot(network, units)
    assert network.network.id == registry.networks.released("tuesday").network.id
    assert {serial: map_sha256(fit.fit.units[serial].unit_map) for serial in fit} == maps(registry)


def test_a_second_batch_changes_nothing(registry, batch):
    before = maps(registry)
    report = batch()
    assert maps(registry) == before and not report["lot_fit"]["units"]
    assert len(registry.decisions.of_lot("tuesday")) == 1


def test_pressing_one_unit_changes_that_unit_alone_and_says_what_a_fit_would_change(lot, registry, batch, capsys):
    before = maps(registry)
    press(lot / "lot", "U5", dwelling_presses(77, 2500, 60.0))
    report = batch()
    after = maps(registry)
    assert {serial for serial in UNITS if after[serial] != before[serial]} == {"U5"}
    assert len(report["lot_fit"]["open"]) == 5 and report["lot_fit"]["number"] == 2
    text = " ".join(capsys.readouterr().out.split())
    assert "lot fit 2 would change maps (units: 5)" in text
    assert "mapped alone: U5: it shares no load in time with other units" in text
    assert decision_in_force(registry, "tuesday").fit.number == 1


def test_presses_that_differ_leave_the_maps_and_are_in_every_forecast_until_it_is_withdrawn(lot, registry, run, batch):
    for serial in UNITS:
        press(lot / "lot", serial, dwelling_presses(9, 2500, 60.0, 0.12, int(serial[1:])))
    report = batch()
    assert sorted(report["lot_fit"]["units"]) == UNITS
    for unit in report["units"]:
        assert unit["map"]["lot_fit"] is None and any("they share no load" in why for why in unit["reasons"])
        alone, now = (registry.calibrations.get(unit["serial"], r).state for r in (unit["map"]["revision"] - 1, None))
        assert now.map_sha256 == alone.map_sha256
        assert now.forecast.rmse > 1.05 * alone.forecast.rmse
        assert np.mean(now.interval.half_width) > 1.05 * np.mean(alone.interval.half_width)
    assert not batch()["lot_fit"]["units"]
    assert run("lot", "fit", "tuesday", "--withdraw", "--reason", "a test", "--yes") == 0
    for serial in UNITS:
        assert "line" not in registry.calibrations.get(serial).state.fit.budget


def test_the_line_says_what_a_fit_would_change(lot, registry):
    away = recorded(dwelling_presses(77, 2500, 60.0), 5)
    moved = OutputRecording("U5", away["t_s"].to_numpy(), away["output"].to_numpy(), RATE_HZ)
    assert str(open_lot_fit(registry, "tuesday", moved)) == "lot fit 2 would change maps (units: 5)"
    with_them = recorded(TOGETHER_N, 9)
    joined = OutputRecording("U9", with_them["t_s"].to_numpy(), with_them["output"].to_numpy(), RATE_HZ)
    assert str(open_lot_fit(registry, "tuesday", joined)) == "lot fit 2 would change maps (units: 7)"
    foreign_unit = OutputRecording("U9", away["t_s"].to_numpy(), away["output"].to_numpy(), RATE_HZ)
    assert open_lot_fit(registry, "tuesday", foreign_unit) is None


def test_a_person_makes_the_next_one_and_is_asked(lot, registry, run, batch, capsys):
    press(lot / "lot", "U5", dwelling_presses(77, 2500, 60.0))
    batch()
    before = maps(registry)
    assert run("lot", "fit", "tuesday") == 2
    assert "lot fit 2 changes maps (units: 5)" in capsys.readouterr().out and maps(registry) == before
    assert run("lot", "fit", "tuesday", "--yes") == 0
    after = maps(registry)
    assert {serial for serial in UNITS if after[serial] != before[serial]} == set(UNITS) - {"U5"}
    fit = decision_in_force(registry, "tuesday").fit
    assert fit.number == 2 and fit.sittings == (tuple(s for s in UNITS if s != "U5"),)
    assert run("lot", "fit", "tuesday", "--yes") == 0 and decision_in_force(registry, "tuesday").fit.number == 2
    assert "no map of lot tuesday changes" in capsys.readouterr().out


def test_a_rollback_takes_it_back_for_a_unit_and_no_batch_undoes_that(registry, run, batch):
    before = maps(registry)
    assert run("registry", "rollback", "--serial", "U2", "--to", "1", "--reason", "pressed by hand", "--yes") == 0
    rolled = maps(registry)
    assert {serial for serial in UNITS if rolled[serial] != before[serial]} == {"U2"}
    report = batch()
    assert maps(registry) == rolled and report["lot_fit"]["open"] == ["U2"]


def test_it_is_withdrawn_as_a_whole_and_a_person_makes_the_next(registry, run, batch, capsys):
    assert run("lot", "fit", "tuesday", "--withdraw", "--yes") == 2 and "--reason" in capsys.readouterr().err
    assert run("lot", "fit", "tuesday", "--withdraw", "--reason", "two presses", "--yes") == 0
    states = [registry.calibrations.get(serial, lot_id="tuesday").state for serial in UNITS]
    assert all(state.fit.lot_fit is None and state.fit.family != "shared_load" for state in states)
    assert len(batch()["lot_fit"]["open"]) == 6
    assert run("lot", "fit", "tuesday", "--yes") == 0
    assert {registry.calibrations.get(s, lot_id="tuesday").state.fit.lot_fit.number for s in UNITS} == {3}


def test_who_was_pressed_otherwise_is_named(lot, registry, run, batch, capsys):
    slipping = TOGETHER_N.copy()
    slipping[900:1100] *= 0.7
    press(lot / "lot", "U6", slipping)
    batch()
    assert "mapped alone: U6: it was pressed otherwise" in " ".join(capsys.readouterr().out.split())
    assert run("lot", "fit", "tuesday", "--yes") == 0
    assert list(decision_in_force(registry, "tuesday").fit.alone) == ["U6"]


def test_a_fit_that_somebody_else_made_meanwhile_is_not_overwritten(lot, registry, batch):
    press(lot / "lot", "U5", dwelling_presses(77, 2500, 60.0))
    batch()
    plan = plan_lot_fit(registry, "tuesday")
    make_lot_fit(registry, plan)
    with pytest.raises(softcal.InputError, match="meanwhile"):
        make_lot_fit(registry, plan)


def test_a_unit_that_somebody_else_changed_meanwhile_keeps_its_newest_map(lot, registry, run, batch):
    press(lot / "lot", "U5", dwelling_presses(77, 2500, 60.0))
    batch()
    plan, before = plan_lot_fit(registry, "tuesday"), maps(registry)
    assert "U1" in plan.states
    assert run("registry", "rollback", "--serial", "U1", "--to", "1", "--reason", "as before", "--yes") == 0
    after = maps(registry)
    assert after["U1"] != before["U1"]
    with pytest.raises(softcal.InputError, match="U1 .* meanwhile"):
        make_lot_fit(registry, plan)
    assert maps(registry) == after and decision_in_force(registry, "tuesday").fit.number == 1


def test_an_audit_is_scored_by_the_map_of_the_lot(lot, registry, batch):
    recorded(dwelling_presses(33, 1500, 5.0), 4).to_csv(lot / "lot/audit/U4.csv", index=False)
    report = batch()
    (unit,) = [one for one in report["units"] if one["serial"] == "U4"]
    state = registry.calibrations.get("U4", lot_id="tuesday").state
    assert unit["audited"] and state.fit.lot_fit is not None and state.audit.map_id == state.map_id


def test_one_labelled_recording_of_the_sitting_gives_the_loads_of_all_and_is_no_audit(lot, registry, run, batch):
    golden = recorded(TOGETHER_N, 3)
    for name in ("golden", "audit"):
        (lot / f"lot/{name}").mkdir(exist_ok=True)
        golden.to_csv(lot / f"lot/{name}/U3.csv", index=False)
    states = {s: registry.calibrations.get(s, lot_id="tuesday").state for s in UNITS}
    report = batch()
    network = registry.networks.get(report["network"])
    for unit in report["units"]:
        assert unit["knowledge"] == "paired" and not unit["audited"] and unit["after_rmse"] is None
        assert any("U3 was pressed with under the load cell" in why for why in unit["reasons"])
        test = recorded(dwelling_presses(33, 1500, 5.0), int(unit["serial"][1:]))
        output = OutputRecording(unit["serial"], test["t_s"].to_numpy(), test["output"].to_numpy(), RATE_HZ)
        errors = [
            rmse(estimate(network, state, output).estimate, test["reference"].to_numpy())
            for state in (states[unit["serial"]], registry.calibrations.get(unit["serial"], lot_id="tuesday").state)
        ]
        assert errors[1] < errors[0]
    assert not newest_audits(registry, "tuesday") and report["release"]["audited"] == 0
    # Brought as an audit through the command it measures nothing either.
    assert run("lot", "audit", "tuesday", str(lot / "lot/audit/U3.csv")) == 0
    assert not newest_audits(registry, "tuesday")
    assert registry.calibrations.get("U3", lot_id="tuesday").state.audit is None


def test_a_golden_run_whose_reference_is_not_its_own_is_refused_in_one_line(lot, run, capsys):
    (lot / "lot/golden").mkdir()
    golden = recorded(TOGETHER_N, 3)
    noise_N = np.random.default_rng(3).normal(0, 0.002, len(golden))
    golden["reference"] = golden["reference"].to_numpy()[::-1] + noise_N
    golden.to_csv(lot / "lot/golden/U3.csv", index=False)
    assert run("batch", str(lot / "lot"), *NETWORK) == 2
    assert "U3" in (stderr := capsys.readouterr().err) and "does not follow its reference" in stderr
