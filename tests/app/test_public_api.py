"""`import softcal`: the README's lines, pandas in and out, the registry, scikit-learn's conventions."""

import json
import re
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone
from sklearn.frozen import FrozenEstimator
from sklearn.model_selection import cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.utils.estimator_checks import estimator_checks_generator

import softcal
from softcal.app.cli.main import main
from softcal.core.simulated_lot import LotDesign, simulate_lot

README = Path(__file__).parents[2] / "README.md"
COOKBOOK = README.parent / "docs" / "python.md"
SMALL = {"hidden": (16, 8)}


@pytest.fixture(scope="module")
def tables(press_unit) -> list[pd.DataFrame]:  # type: ignore[no-untyped-def]
    """Source and two units, each pressed for 30 s at 50 Hz; gains 1, 1.15 and 1.3."""
    return [press_unit(1500, 1 + 0.15 * k, 0.5 + 0.04 * k, k + 1) for k in range(3)]


@pytest.fixture(scope="module")
def source(tables: list[pd.DataFrame]) -> softcal.SourceNetwork:
    return softcal.fit_network(
        softcal.Recording.from_frame(tables[0], reference="reference", time_s="t_s", serial="S1"), **SMALL
    )


@pytest.fixture(scope="module")
def unit(source: softcal.SourceNetwork, tables: list[pd.DataFrame]) -> softcal.Unit:
    return softcal.fit_map(source, softcal.Recording.from_frame(tables[1], time_s="t_s", serial="S2"))


def write(tables: list[pd.DataFrame], folder: Path, columns: dict[str, str]) -> list[str]:
    """Write S1 and S2 with their columns renamed, and return the files."""
    files = [str(folder / f"S{k}.csv") for k in (1, 2)]
    for table, file in zip(tables, files, strict=False):
        table.rename(columns=columns).to_csv(file, index=False)
    return files


def saved_loaded_and_exported(unit: softcal.Unit, folder: Path) -> None:
    """Save a unit, load it, and write the files of both, which are the same."""
    unit.save(folder / "saved.db")
    again = softcal.Unit.load(folder / "saved.db")
    assert (again.verdict, again.reasons, again.predicted_rmse) == (unit.verdict, unit.reasons, unit.predicted_rmse)
    for name, one in (("new", unit), ("again", again)):
        (file, *_) = one.export(folder / name, "json", release="conditional")
        assert json.loads(file.read_text())["calibration"]["map_sha256"]


def test_the_readme_example_runs_as_written(tables, tmp_path, monkeypatch, capsys):
    code = re.search(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    assert code and len([line for line in code[1].splitlines() if line.strip()]) <= 6
    write(tables, tmp_path, {"output": "output_V", "reference": "force_N"})
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(compile(code[1], "README.md", "exec"), names)
    printed = capsys.readouterr().out
    assert printed.split()[0] in ("pass", "conditional", "fail", "retest") and "estimate" in printed
    saved_loaded_and_exported(names["unit"], tmp_path)


def test_the_cookbook_runs_as_written(tables, tmp_path, monkeypatch, registry_url):
    # The registry of the small lot knows A1 to A3; the cookbook's reader has calibrated S2.
    blocks = re.findall(r"```python\n(.*?)```", COOKBOOK.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) >= 6
    files = write(tables, tmp_path, {"output": "output_V", "reference": "force_N"})
    lot = ["--source", "S1", "--output-column", "output_V", "--reference-column", "force_N", "--sample-rate", "50"]
    assert main(["import", *files, *lot, "--out", str(tmp_path / "lot")]) == 0
    main(["batch", str(tmp_path / "lot"), "--hidden", "16,8", "--registry", registry_url])
    monkeypatch.setenv("SOFTCAL_REGISTRY", registry_url)
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, "python.md", "exec"), names)
    assert names["files"] and all(file.is_file() for file in names["files"])  # type: ignore[attr-defined]
    saved_loaded_and_exported(names["audited"], tmp_path)
    assert np.isfinite(names["estimate"]).all() and len(names["force_N"]) == len(names["output_V"])  # type: ignore[call-overload, arg-type]


def test_every_public_name_is_there_and_nothing_is_loaded_before_it_is_asked_for():
    assert all(getattr(softcal, name) is not None for name in softcal.__all__)
    assert sorted(softcal.__all__) == dir(softcal)
    code = "import softcal, sys; print([m for m in ('numpy', 'pandas', 'torch', 'sqlalchemy') if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"
    with pytest.raises(AttributeError, match="'fit_maps'"):
        softcal.fit_maps  # noqa: B018


def test_a_unit_of_another_gain_is_estimated_without_its_reference(source, unit, tables):
    reference = tables[1]["reference"].to_numpy()
    estimates = unit.estimate(tables[1]["output"])
    uncorrected = softcal.fit_map(
        source, softcal.Recording.from_frame(tables[1], time_s="t_s", serial="S2"), family="identity"
    )
    error = np.sqrt(np.nanmean((estimates["estimate"] - reference) ** 2))
    unmapped = np.sqrt(np.nanmean((uncorrected.estimate(tables[1]["output"])["estimate"] - reference) ** 2))
    assert error < 0.5 * unmapped
    assert (estimates["lower"] <= estimates["estimate"])[14:].all() and estimates["estimate"][:14].isna().all()


def test_the_reference_of_a_target_changes_nothing(source, unit, tables):
    labelled = tables[1].assign(reference=0.0)
    with_labels = softcal.Recording.from_frame(labelled, reference="reference", time_s="t_s", serial="S2")
    again = softcal.fit_map(source, with_labels)
    pd.testing.assert_frame_equal(again.estimate(tables[1]["output"]), unit.estimate(tables[1]["output"]))


def test_pandas_keeps_its_index_and_arrays_give_the_same_numbers(unit, tables):
    series = tables[1]["output"].set_axis(range(7, 1507))
    by_series, by_array = unit.estimate(series), unit.estimate(series.to_numpy())
    assert list(by_series.index) == list(range(7, 1507))
    np.testing.assert_array_equal(by_series["estimate"], by_array["estimate"])
    recording = softcal.Recording.from_frame(tables[1], reference="reference", time_s="t_s")
    pd.testing.assert_frame_equal(recording.to_frame(), tables[1][["t_s", "output", "reference"]])


def test_python_and_command_line_give_one_calibration(tables, source, unit, tmp_path):
    files, url = write(tables, tmp_path, {}), f"sqlite:///{tmp_path / 'registry.db'}"
    options = [
        "--source",
        "S1",
        "--reference-column",
        "reference",
        "--time-column",
        "t_s",
        "--out",
        str(tmp_path / "lot"),
    ]
    assert main(["import", *files, *options]) == 0
    main(["batch", str(tmp_path / "lot"), "--hidden", "16,8", "--registry", url])
    with softcal.open_registry(url) as registry:
        registered = softcal.Unit.from_registry(registry, "S2")
    assert registered.network.id == source.network.id
    pd.testing.assert_frame_equal(registered.estimate(tables[1]["output"]), unit.estimate(tables[1]["output"]))
    assert (registered.verdict, registered.family, registered.predicted_rmse) == (
        unit.verdict,
        unit.family,
        unit.predicted_rmse,
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"output": [1.0] * 20}, "sample_rate_Hz .*t_s"),
        ({"output": [float("nan")] * 20, "sample_rate_Hz": 50}, "output .*20"),
        ({"output": ["a"] * 20, "sample_rate_Hz": 50}, "output "),
        ({"output": [1.0] * 20, "reference": [1.0] * 19, "sample_rate_Hz": 50}, "reference .*19"),
        ({"output": [1.0] * 20, "sample_rate_Hz": -1}, "sample_rate_Hz"),
    ],
)
def test_a_bad_recording_is_refused_when_it_is_made(arguments, message):
    with pytest.raises(softcal.InputError, match=message):
        softcal.Recording(**arguments)


def test_a_missing_column_lists_those_there_are(tables):
    with pytest.raises(softcal.InputError, match="'outpt'.*t_s, output, reference"):
        softcal.Recording.from_frame(tables[0], output="outpt", time_s="t_s")


def test_anchors_must_come_in_pairs(source, tables):
    target = softcal.Recording.from_frame(tables[1], time_s="t_s")
    with pytest.raises(softcal.InputError):
        softcal.fit_map(source, target, anchors=([0.5, 0.6], [0.0]))
    anchored = softcal.fit_map(source, target, anchors=pd.DataFrame({"output": [0.54], "reference": [0.0]}))
    assert anchored.predicted_rmse is not None


@pytest.mark.parametrize("serial", ["S1", "S2"])
def test_a_unit_is_saved_loaded_and_exported_without_a_registry(source, tables, tmp_path, serial):
    target = softcal.Recording.from_frame(tables[1], time_s="t_s", serial=serial)
    unit = softcal.fit_map(source, target)
    unit.save(tmp_path / "unit.db")
    again = softcal.Unit.load(tmp_path / "unit.db")
    assert (again.serial, again.verdict, again.reasons) == (serial, unit.verdict, unit.reasons)
    pd.testing.assert_frame_equal(again.estimate(target), unit.estimate(target))
    with pytest.raises(softcal.UnitRefused, match=unit.verdict):
        unit.export(tmp_path / "held")
    files = {one: made_unit.export(tmp_path / one, "json", release="conditional") for one, made_unit in
             (("new", unit), ("kept", again))}  # fmt: skip
    calibrations = [json.loads(Path(paths[0]).read_text())["calibration"] for paths in files.values()]
    assert (
        calibrations[0]["map_sha256"] == calibrations[1]["map_sha256"]
        and calibrations[0]["arrays"] == calibrations[1]["arrays"]
    )
    assert main(["estimate", "--registry", f"sqlite:///{tmp_path / 'unit.db'}", "--serial", serial,
                 str(write(tables, tmp_path, {})[1]), "--out", str(tmp_path / "out.csv")]) == 0  # fmt: skip
    with pytest.raises(softcal.InputError, match="nowhere.db"):
        softcal.Unit.load(tmp_path / "nowhere.db")


def test_units_make_a_table_and_say_themselves_in_one_short_line(source, unit, tables):
    lot = pd.concat([unit.to_frame(), unit.to_frame()])
    assert list(lot["serial"]) == ["S2", "S2"] and lot["predicted_rmse"].notna().all()
    for one, names in (
        (unit, ("S2", unit.verdict)),
        (softcal.Recording.from_frame(tables[0], time_s="t_s"), ("1500",)),
    ):
        assert len(repr(one)) < 120 and all(name in repr(one) for name in names)


def test_pandas_goes_in_everywhere(tables, unit):
    network = softcal.fit_network(tables[0], **SMALL)
    output = tables[1]["output"]
    for recording in (
        tables[1],
        tables[1][["t_s", "output"]],
        tables[1][["output"]],
        output,
        output.to_numpy(),
        list(output),
    ):
        fitted_unit = softcal.fit_map(network, recording, audit=tables[1])
        assert fitted_unit.state.scores is not None
        assert len(fitted_unit.estimate(recording)) == 1500 and fitted_unit.map.family
    assert fitted_unit.rmse(tables[1]) == pytest.approx(fitted_unit.rmse(softcal.Recording.from_frame(
        tables[1], reference="reference", time_s="t_s")))  # fmt: skip
    shifted = tables[1].set_index(tables[1].index + 7)
    assert list(unit.estimate(shifted).index[:2]) == [7, 8]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda f, t: softcal.Recording([1.0] * 20, sample_rate_Hz="50"), "sample_rate_Hz is '50'.*number"),
        (lambda f, t: softcal.Recording([1.0] * 20, sample_rate_Hz=True), "sample_rate_Hz is True"),
        (lambda f, t: softcal.Recording([1.0] * 20, sample_rate_Hz=50, serial=7), "serial is 7 .*text"),
        (lambda f, t: softcal.Recording(t, sample_rate_Hz=50), "output is a table"),
        (lambda f, t: softcal.fit_network("S1.csv"), "source is 'S1.csv'.*Recording"),
        (lambda f, t: softcal.fit_network(t[["output", "reference"]]), "sample_rate_Hz"),
        (lambda f, t: softcal.fit_network(t, seed="1"), "seed is '1'"),
        (lambda f, t: softcal.fit_network(t, hidden=8), "hidden is 8"),
        (lambda f, t: softcal.fit_map("S1", t), "network is 'S1'.*fit_network"),
        (lambda f, t: softcal.fit_map(f, None), "target is None"),
        (lambda f, t: softcal.fit_map(f, {"output": [1.0]}), "target is "),
        (lambda f, t: softcal.fit_map(f, t, limit_rmse="0.2"), "limit_rmse is '0.2'"),
        (lambda f, t: softcal.fit_map(f, t, family=3), "family is 3"),
        (lambda f, t: softcal.fit_map(f, t, anchors=5), "anchors"),
        (lambda f, t: softcal.fit_map(f, t, anchors=pd.DataFrame({"output": [0.5]})), "anchors.*reference"),
    ],
)
def test_a_wrong_type_is_one_line_with_value_and_expectation(source, tables, call, message):
    with pytest.raises(softcal.InputError, match=message) as refused:
        call(source, tables[0])
    assert "\n" not in str(refused.value)


def test_a_pipeline_hands_on_data_frames_where_it_is_asked_to(source, tables):
    transformer = softcal.MapTransformer(source).set_output(transform="pandas")
    windows = transformer.fit(tables[1][["output"]]).transform(tables[1][["output"]])
    assert isinstance(windows, pd.DataFrame) and list(windows.columns[[0, -1]]) == ["window_14", "window_0"]
    assert windows.index.equals(tables[1].index)


def test_another_rate_and_an_inverted_channel_are_refused_by_map_and_transformer(source, tables):
    output = tables[1]["output"]
    for rate_Hz in (10.0, 100.0):
        with pytest.raises(softcal.UnitRefused, match=f"{rate_Hz:g} Hz.*50 Hz"):
            softcal.fit_map(source, softcal.Recording(output, sample_rate_Hz=rate_Hz))
        with pytest.raises(softcal.UnitRefused, match="50 Hz"):
            softcal.MapTransformer(source, sample_rate_Hz=rate_Hz).fit(output.to_frame())
    inverted = 2.0 - output
    assert softcal.fit_map(source, inverted).verdict == "fail"
    with pytest.raises(softcal.UnitRefused, match="direction"):
        softcal.MapTransformer(source).fit(inverted.to_frame())


@pytest.mark.parametrize(
    "check",
    [
        pytest.param(partial(check, estimator), id=check.func.__name__)
        for estimator, check in estimator_checks_generator(softcal.NetworkRegressor(hidden=(8,), max_epochs=60))
        # Arrays of other libraries are not promised, and SciPy must be told before its import to try them.
        if check.func.__name__ != "check_array_api_input"
    ],
)
def test_the_network_keeps_every_convention_of_scikit_learn(check):
    check()


def test_a_map_and_the_network_make_a_pipeline(source, tables):
    recording = softcal.Recording.from_frame(tables[0], reference="reference", time_s="t_s").labelled
    regressor = softcal.NetworkRegressor(hidden=(16, 8)).fit(recording.windows, recording.window_reference)
    pipeline = make_pipeline(softcal.MapTransformer(source), FrozenEstimator(regressor))
    output, reference = tables[2][["output"]], tables[2]["reference"]
    mapped = pipeline.fit(output).score(output, reference)
    unmapped = make_pipeline(softcal.MapTransformer(source, family="identity"), FrozenEstimator(regressor))
    assert mapped > unmapped.fit(output).score(output, reference)
    assert clone(pipeline[0]).get_params()["family"] == "auto"
    assert pipeline[0].family_ != "auto" and pipeline[0].transform(output).shape == (1500, 15)


def test_a_transformer_says_what_it_lacks(source, tables):
    with pytest.raises(softcal.InputError, match="source"):
        softcal.MapTransformer().fit(tables[1][["output"]])
    with pytest.raises(ValueError, match="one column"):
        softcal.MapTransformer(source).fit(tables[1][["output", "reference"]])
    with pytest.raises(softcal.InputError, match="'affin'"):
        softcal.MapTransformer(source, family="affin").fit(tables[1][["output"]])


@pytest.mark.long
def test_the_network_is_worth_as_much_to_cross_validation_as_to_the_command_line(tables):
    recording = softcal.Recording.from_frame(tables[0], reference="reference", time_s="t_s").labelled
    regressor = softcal.NetworkRegressor(hidden=(16, 8))
    scores = cross_val_score(regressor, recording.windows, recording.window_reference, cv=3)
    assert scores.min() > 0.8


def test_a_stage_position_reaches_the_map():
    lot = simulate_lot(1, LotDesign(good=1, source_s=40, unit_s=30, audit_s=30, has_stage=True))
    tables = [lot.source.unlabelled.arrays() | {"reference": lot.source.reference}, lot.units[0].recording.arrays()]
    columns = {"time_s": "t_s", "stage_mm": "stage_mm"}
    source = softcal.Recording.from_frame(pd.DataFrame(tables[0]), reference="reference", **columns)
    target = softcal.Recording.from_frame(pd.DataFrame(tables[1]), **columns)
    assert softcal.fit_map(softcal.fit_network(source, **SMALL), target).family == "stage_matched"
    assert list(target.to_frame()) == ["t_s", "output", "stage_mm"]
    with pytest.raises(softcal.InputError, match="'where'"):
        softcal.Recording.from_frame(pd.DataFrame(tables[1]), time_s="t_s", stage_mm="where")
