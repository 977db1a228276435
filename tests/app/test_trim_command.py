"""`softcal trim`: two loads mend a unit in the registry; loads of something else change nothing."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.app.cli.main import main
from softcal.core.unit.state import UnitState
from softcal.core.windows import windows
from softcal.db.connection import open_registry
from tests.device_sensor import estimate_output, open_sensor

GAIN, OFFSET_V = 1.15, 0.54


def batch(lot_folder: Path, registry_url: str) -> int:
    return main(["batch", str(lot_folder), "--registry", registry_url, "--hidden", "16,8", "--no-own"])


@pytest.fixture
def trimmed(lot_folder: Path, registry_url: str, tmp_path: Path):  # type: ignore[no-untyped-def]
    """`trimmed(output, reference)`: the exit code of a trim of A1 by these loads."""
    batch(lot_folder, registry_url)

    def run(output: list[float], reference: list[float]) -> int:
        file = tmp_path / "loads.csv"
        pd.DataFrame({"output": output, "reference": reference}).to_csv(file, index=False)
        return main(["trim", "--registry", registry_url, "--serial", "A1", "--loads", str(file), "--yes"])

    return run


def drifted_V(load_N: float) -> float:
    """Return the output of A1 at rest under a load, its zero moved by 20 mV and its gain by a tenth."""
    return OFFSET_V + 0.02 + 1.1 * GAIN * (0.1 * load_N + 0.02 * load_N**2)


def _revisions(url: str) -> int:
    with open_registry(url) as registry:
        return len(registry.calibrations.history("A1"))


def test_two_loads_make_a_revision_that_reads_them(trimmed, registry_url, tmp_path, press_unit, capsys):
    before = _revisions(registry_url)
    later_press = press_unit(900, 1.1 * GAIN, OFFSET_V + 0.02, 88)
    later_press[["t_s", "output"]].to_csv(tmp_path / "in.csv", index=False)

    def error() -> float:
        out = tmp_path / "out.csv"
        command = ["estimate", "--registry", registry_url, "--serial", "A1", str(tmp_path / "in.csv")]
        assert main([*command, "--out", str(out)]) == 0
        return float(np.sqrt(np.nanmean((pd.read_csv(out)["estimate"] - later_press["reference"]) ** 2)))

    drifted = error()
    capsys.readouterr()
    assert trimmed([drifted_V(0.0), drifted_V(2.5)], [0.0, 2.5]) == 0
    assert capsys.readouterr().out.count("± ") >= 2, "how well the loads fix gain and zero"
    assert error() < 0.6 * drifted
    assert _revisions(registry_url) == before + 1
    with open_registry(registry_url) as registry:
        record = registry.calibrations.get("A1").state
    assert record.correspondence.is_anchored and record.verdict != "pass" and record.scores is None


@pytest.mark.parametrize(
    ("output", "reference"),
    [
        ([0.54], [0.0]),
        ([0.54, 0.9], [0.0, 2500.0]),
        ([0.9, 0.54], [0.0, 2.5]),
        ([0.54, 0.9, 0.9], [0.0, 2.5, 2.5]),
        ([0.54, 0.5401], [0.0, 2.5]),
        ([0.54, 0.75, 0.97], [0.0, 2.5, 2.55]),
    ],
    ids=["one", "of another unit", "exchanged", "the same", "not told apart", "contradict"],
)
def test_loads_that_cannot_be_of_it_change_nothing(trimmed, registry_url, capsys, output, reference):
    before = _revisions(registry_url)
    capsys.readouterr()
    assert trimmed(output, reference) == 2
    assert capsys.readouterr().err.count("\n") == 1 and _revisions(registry_url) == before


def _measured_badly(lot_folder: Path) -> None:
    """The audit of A1 finds loads 1.5 times what the unit reads."""
    file = lot_folder / "audit" / "A1.csv"
    audit = pd.read_csv(file)
    audit.assign(reference=1.5 * audit["reference"]).to_csv(file, index=False)


def test_a_trim_does_not_lift_a_measured_fail(trimmed, lot_folder, registry_url, tmp_path):
    _measured_badly(lot_folder)
    assert batch(lot_folder, registry_url) == 1
    loads = [drifted_V(0.0), drifted_V(2.5)], [0.0, 2.5]
    for _ in range(2):
        assert trimmed(*loads) == 0
        assert batch(lot_folder, registry_url) == 1, "a batch that measures nothing new decides nothing new"
        with open_registry(registry_url) as registry:
            record = registry.calibrations.get("A1").state
        assert record.verdict == "fail" and record.decision.is_audited
        assert record.scores is None, "the error was measured with the map before the trim"
        assert {"trimmed", "audited_before_trim"} <= {why.code for why in record.decision.reasons}
    out = str(tmp_path / "out")
    export = ["export", "--registry", registry_url, "--serial", "A1", "--format", "blob", "--out", out]
    for more in ([], ["--release", "conditional"]):
        assert main([*export, *more]) == 2
        assert not list((tmp_path / "out").glob("unit-*"))


def test_a_new_audit_decides_on_a_trimmed_unit_and_older_ones_of_others_do_not(trimmed, lot_folder, registry_url):
    assert trimmed([drifted_V(0.0), drifted_V(2.5)], [0.0, 2.5]) == 0
    batch(lot_folder, registry_url)
    with open_registry(registry_url) as registry:
        record = registry.calibrations.get("A1").state
    assert record.verdict == "conditional" and not record.decision.is_audited
    assert "audited_before_trim" in {why.code for why in record.decision.reasons}
    assert record.trim_in_force is not None, "the batch leaves the trimmed map in use"


def _record(url: str) -> UnitState:
    with open_registry(url) as registry:
        return registry.calibrations.get("A1").state


def test_a_new_fit_of_the_same_recording_keeps_the_trim(trimmed, lot_folder, registry_url):
    assert trimmed([drifted_V(0.0), drifted_V(2.5)], [0.0, 2.5]) == 0
    before = _record(registry_url)
    assert main(["batch", str(lot_folder), "--registry", registry_url, "--hidden", "16,8", "--no-own", "--refit"]) == 1
    after = _record(registry_url)
    assert after.map_sha256 == before.map_sha256
    assert np.array_equal(after.interval.half_width, before.interval.half_width)
    assert {"trimmed", "audited_before_trim"} <= {why.code for why in after.decision.reasons}


def test_a_new_audit_of_a_trimmed_unit_is_measured_with_the_trimmed_map(trimmed, lot_folder, registry_url, press_unit):
    assert trimmed([drifted_V(0.0), drifted_V(2.5)], [0.0, 2.5]) == 0
    before, audit = _record(registry_url), press_unit(900, 1.1 * GAIN, OFFSET_V + 0.02, 89)
    audit.to_csv(lot_folder / "audit" / "A1.csv", index=False)
    batch(lot_folder, registry_url)
    after = _record(registry_url)
    assert after.map_sha256 == before.map_sha256 and after.decision.is_audited
    assert after.scores.after.rmse < 0.6 * after.scores.before.rmse
    assert not {why.code for why in after.decision.reasons} & {"trimmed", "audited_before_trim"}


def test_a_trim_is_older_than_a_new_recording_and_the_unit_says_so(trimmed, lot_folder, registry_url, press_unit):
    assert trimmed([drifted_V(0.0), drifted_V(2.5)], [0.0, 2.5]) == 0
    first, file = _record(registry_url), lot_folder / "units" / "A1.csv"
    old, new = file.read_bytes(), press_unit(1500, 1.1 * GAIN, OFFSET_V + 0.02, 90)
    new[["t_s", "output"]].to_csv(file, index=False)
    batch(lot_folder, registry_url)
    second = _record(registry_url)
    assert second.trim_in_force is None and "trim.older" in {why.code for why in second.decision.reasons}
    file.write_bytes(old)
    batch(lot_folder, registry_url)
    assert _record(registry_url).map_sha256 == first.map_sha256


def test_a_map_that_a_person_brought_back_is_not_trimmed_again(trimmed, lot_folder, registry_url):
    untrimmed = _record(registry_url)
    assert trimmed([drifted_V(0.0), drifted_V(2.5)], [0.0, 2.5]) == 0
    back = [
        "registry",
        "rollback",
        "--registry",
        registry_url,
        "--serial",
        "A1",
        "--to",
        "1",
        "--reason",
        "heavier",
        "--yes",
    ]
    assert main(back) == 0
    assert main(["batch", str(lot_folder), "--registry", registry_url, "--hidden", "16,8", "--no-own", "--refit"]) == 0
    assert _record(registry_url).map_sha256 == untrimmed.map_sha256


def test_a_second_trim_replaces_the_first(trimmed, registry_url):
    assert trimmed([drifted_V(0.0), drifted_V(2.5)], [0.0, 2.5]) == 0
    with open_registry(registry_url) as registry:
        first = registry.calibrations.get("A1").state
    assert trimmed([drifted_V(0.0) + 0.3, drifted_V(2.5) + 0.3], [0.0, 2.5]) == 0
    assert trimmed([drifted_V(0.0), drifted_V(2.5)], [0.0, 2.5]) == 0
    with open_registry(registry_url) as registry:
        third = registry.calibrations.get("A1").state
    assert third.map_sha256 == first.map_sha256
    assert np.array_equal(third.interval.half_width, first.interval.half_width)


def test_a_trimmed_unit_is_in_range_where_it_is_now(trimmed, registry_url, tmp_path, press_unit):
    """By a command, and in the file of a device."""
    assert trimmed([drifted_V(0.0) + 0.1, drifted_V(2.5) + 0.1], [0.0, 2.5]) == 0
    later_press, out = press_unit(900, 1.1 * GAIN, OFFSET_V + 0.12, 88), tmp_path / "out"
    later_press[["t_s", "output"]].to_csv(tmp_path / "in.csv", index=False)
    common = ["--registry", registry_url, "--serial", "A1"]
    assert main(["estimate", *common, str(tmp_path / "in.csv"), "--out", str(tmp_path / "est.csv")]) == 0
    assert not (pd.read_csv(tmp_path / "est.csv")["flag"] == "out of range").any()
    assert main(["export", *common, "--format", "blob", "--release", "conditional", "--out", str(out)]) == 0
    network, unit = (next(out.glob(f"{kind}-*.ssc")).read_bytes() for kind in ("network", "unit"))
    sensor = open_sensor(network, unit)
    value, _, _, flags = estimate_output(sensor, windows(later_press["output"].to_numpy()))
    assert np.mean(flags > 0) < 0.01
    assert np.sqrt(np.mean((value - later_press["reference"].to_numpy()[14:]) ** 2)) < 0.2


def test_a_stream_that_begins_with_known_loads_is_followed_from_the_trimmed_map(
    trimmed, registry_url, tmp_path, press_unit
):
    later_press = press_unit(900, 1.1 * GAIN, OFFSET_V + 0.02, 88)
    later_press[["t_s", "output"]].to_csv(tmp_path / "use.csv", index=False)
    loads, out = tmp_path / "loads.csv", tmp_path / "out.csv"
    pd.DataFrame({"output": [drifted_V(0.0), drifted_V(2.5)], "reference": [0.0, 2.5]}).to_csv(loads, index=False)
    before = _revisions(registry_url)

    def error(*more: str) -> float:
        command = ["adapt", "--registry", registry_url, "--serial", "A1", str(tmp_path / "use.csv"), "--out", str(out)]
        assert main([*command, "--mode", "none", *more]) == 0
        return float(np.sqrt(np.nanmean((pd.read_csv(out)["estimate"] - later_press["reference"]) ** 2)))

    drifted = error()
    assert error("--loads", str(loads)) < 0.6 * drifted
    # Followed again, the stream begins with the map it began with.
    assert error("--loads", str(loads)) < 0.6 * drifted
    assert _revisions(registry_url) == before + 1


def test_known_loads_do_not_go_with_an_older_map_or_a_stream_that_goes_on(trimmed, registry_url, capsys):
    common = ["adapt", "--registry", registry_url, "--serial", "A1", "in.csv", "--out", "out.csv", "--loads", "l.csv"]
    for more in (["--resume"], ["--revision", "1"]):
        capsys.readouterr()
        assert main([*common, *more]) == 2
        assert more[0] in capsys.readouterr().err


def test_known_loads_lie_in_the_lot_folder(lot_folder, registry_url):
    output_V = [OFFSET_V, OFFSET_V + GAIN * (0.1 * 2.5 + 0.02 * 2.5**2)]
    loads = pd.DataFrame({"serial": "A1", "output": output_V, "reference": [0.0, 2.5]})
    loads.to_csv(lot_folder / "anchors.csv", index=False)
    batch = ["batch", str(lot_folder), "--registry", registry_url, "--hidden", "16,8", "--no-own"]
    main(batch)
    with open_registry(registry_url) as registry:
        assert registry.calibrations.get("A1").state.correspondence.is_anchored
        assert not registry.calibrations.get("A2").state.correspondence.is_anchored
    loads.assign(serial="NOBODY").to_csv(lot_folder / "anchors.csv", index=False)
    assert main(batch) == 2
