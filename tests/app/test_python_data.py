"""Data as scientists have them go into `import softcal`: numbers, columns and times of any library, many units at once.

What goes in is compared with the same data as plain float64 arrays.
"""

import copy
import pickle
import subprocess
import sys
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone
from decimal import Decimal
from fractions import Fraction
from functools import partial

import numpy as np
import pandas as pd
import pytest
import torch

import softcal
from softcal.app.api import network as network_module
from softcal.app.registry.lot_recordings import newest_audits
from softcal.core.network.config import NetworkConfig

SMALL = {"hidden": (8,)}
N = 600


@pytest.fixture(scope="module", autouse=True)
def few_epochs():
    """What data become of is proven here, not how well f is trained: twenty epochs do."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(network_module, "NetworkConfig", partial(NetworkConfig, max_epochs=20))
        yield


@pytest.fixture(scope="module")
def source(press_unit) -> pd.DataFrame:  # type: ignore[no-untyped-def]
    return press_unit(N, 1.0, 0.5, 1)


@pytest.fixture(scope="module")
def table(press_unit) -> pd.DataFrame:  # type: ignore[no-untyped-def]
    return press_unit(N, 1.2, 0.55, 2)


@pytest.fixture(scope="module")
def network(source: pd.DataFrame) -> softcal.SourceNetwork:
    return softcal.fit_network(source, **SMALL)


def plain(table: pd.DataFrame, **options: object) -> softcal.Recording:
    """The recording of a table as plain arrays."""
    output, reference = table["output"].to_numpy(), table["reference"].to_numpy()
    return softcal.Recording(output, reference, **{"sample_rate_Hz": 50.0, **options})  # type: ignore[arg-type]


# Numbers


RATES = [50, 50.0, np.float32(50), np.float64(50), np.int64(50), np.uint8(50), Fraction(50), Decimal(50), np.array(50)]


@pytest.mark.parametrize("rate_Hz", [*RATES, torch.tensor(50.0)], ids=lambda rate: type(rate).__name__)
def test_equal_rates_make_one_recording(table, rate_Hz):
    recording = plain(table, sample_rate_Hz=rate_Hz)
    assert type(recording.sample_rate_Hz) is float
    assert recording.labelled.sha256 == plain(table).labelled.sha256


@pytest.mark.parametrize("rate_Hz", ["50", b"50", True, np.True_, None, np.array([50.0]), [50], 50 + 0j, "fifty",
                                     float("nan"), float("inf"), Decimal("NaN"), pd.NA, 0, -50, 10**400])  # fmt: skip
def test_a_rate_that_is_no_positive_number_is_refused_in_one_line(table, rate_Hz):
    with pytest.raises(softcal.InputError, match="sample_rate_Hz") as refused:
        plain(table, sample_rate_Hz=rate_Hz)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("rate_Hz", "limit_rmse"), [(50, None), (np.float32(50), 2), (Decimal(50), np.float32(2.5)), (50.0, Fraction(5, 2))]
)
def test_a_unit_of_any_numbers_is_saved_loaded_and_exported(source, table, tmp_path, rate_Hz, limit_rmse):
    network = softcal.fit_network(plain(source, sample_rate_Hz=rate_Hz), **SMALL)
    unit = softcal.fit_map(network, plain(table, sample_rate_Hz=rate_Hz, serial="S2"), limit_rmse=limit_rmse,
                           audit=plain(table, sample_rate_Hz=rate_Hz, serial="S2"))  # fmt: skip
    unit.save(tmp_path / "S2.db")
    again = softcal.Unit.load(str(tmp_path / "S2.db"))
    assert (again.verdict, again.reasons, again.predicted_rmse) == (unit.verdict, unit.reasons, unit.predicted_rmse)
    pd.testing.assert_frame_equal(again.estimate(table), unit.estimate(table))
    for k, one in enumerate((unit, again)):
        (first, *_) = one.export(str(tmp_path / str(k)), "json", release="conditional")
        assert first.is_file()


def test_a_limit_that_was_derived_is_stated_by_nobody_after_load(network, table, tmp_path):
    softcal.fit_map(network, plain(table, serial="S2")).save(tmp_path / "derived.db")
    softcal.fit_map(network, plain(table, serial="S2"), limit_rmse=2).save(tmp_path / "stated.db")
    limits = {}
    for name in ("derived", "stated"):
        with softcal.open_registry(f"sqlite:///{tmp_path / name}.db") as registry:
            limits[name] = registry.lots.get("python").limit_rmse
    assert limits == {"derived": None, "stated": 2.0}


@pytest.mark.parametrize("hidden", [[8], np.array([8]), (np.int64(8),), (np.array(8),)], ids=str)
def test_equal_network_settings_give_one_network(source, network, hidden):
    assert (
        softcal.fit_network(source, hidden=hidden, seed=np.int64(0), members=np.array(1)).network.id
        == network.network.id
    )


@pytest.mark.parametrize(
    "settings",
    [{"hidden": (0,)}, {"hidden": (-3,)}, {"hidden": ("8",)}, {"hidden": (8.5,)}, {"hidden": "8"}, {"hidden": None},
     {"members": 0}, {"members": True}, {"seed": -1}, {"seed": 1.5}, {"seed": "1"}, {"seed": None}, {"seed": 2**70}],
    ids=str,
)  # fmt: skip
def test_a_network_setting_out_of_range_is_refused_in_one_line(source, settings):
    (name,) = settings
    with pytest.raises(softcal.InputError, match=f"{name} is "):
        softcal.fit_network(source, **settings)


@pytest.mark.parametrize("limit", ["2", True, 0, -1, float("nan"), [2.0], pd.NA])
def test_a_limit_that_is_no_positive_number_is_refused(network, table, limit):
    with pytest.raises(softcal.InputError, match="limit"):
        softcal.fit_map(network, table, limit_rmse=limit)


@pytest.mark.parametrize("path", [7, None, b"unit.db", "", "a\0b", ["unit.db"]], ids=repr)
def test_a_path_that_is_none_is_refused_in_one_line(network, table, path):
    unit = softcal.fit_map(network, table)
    calls = (unit.save, softcal.Unit.load, unit.export, softcal.Recording.read, softcal.diagnose)
    for call in calls:
        with pytest.raises(softcal.InputError, match=r"(path|out|case) is "):
            call(path)


def test_a_path_is_text_or_a_path_object(network, table, tmp_path):
    table.to_csv(tmp_path / "S2.csv", index=False)
    for path in (tmp_path / "S2.csv", str(tmp_path / "S2.csv"), np.str_(tmp_path / "S2.csv")):
        assert softcal.Recording.read(path).serial == "S2"
    with pytest.raises(softcal.InputError, match="electronics"):
        softcal.diagnose(str(tmp_path / "S2.csv"))


@pytest.mark.parametrize("serial", [7, None, b"S2", "", "a b", "../S2", "a" * 65, "CON"], ids=repr)
def test_a_serial_that_no_file_can_have_is_refused_when_the_recording_is_made(table, serial):
    with pytest.raises(softcal.InputError):
        plain(table, serial=serial)
    assert type(plain(table, serial=np.str_("S2")).serial) is str


# Columns


def columns_of(values: np.ndarray) -> dict[str, object]:
    """The same values in the types of other libraries."""
    padded = np.column_stack([values, values])
    read_only = values.copy()
    read_only.flags.writeable = False
    return {
        "list": values.tolist(),
        "tuple": tuple(values.tolist()),
        "list of NumPy scalars": list(values),
        "object": values.astype(object),
        "Decimal": [Decimal(value) for value in values.tolist()],
        "Fraction": [Fraction(value) for value in values.tolist()],
        "big endian": values.astype(">f8"),
        "long double": values.astype(np.longdouble),
        "every second": padded.ravel()[::2],
        "a column": padded[:, 0],
        "backward": values[::-1].copy()[::-1],
        "read only": read_only,
        "masked array": np.ma.array(values),
        "Series": pd.Series(values, index=range(7, 7 + len(values))),
        "Series of objects": pd.Series(values, dtype=object),
        "Index": pd.Index(values),
        "nullable": pd.Series(values, dtype="Float64"),
        "nullable array": pd.array(values, dtype="Float64"),
        "Arrow": pd.Series(values, dtype="double[pyarrow]"),
        "categories": pd.Series(values).astype("category"),
        "tensor": torch.tensor(values),
        "memoryview": memoryview(values),
    }


KINDS = list(columns_of(np.arange(3.0)))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["output", "reference", "stage_mm", "t_s"])
def test_a_column_of_any_kind_is_the_same_recording(table, name, kind):
    whole = {"output": table["output"].to_numpy(), "reference": table["reference"].to_numpy(),
             "stage_mm": table["reference"].to_numpy() / 2, "t_s": table["t_s"].to_numpy()}  # fmt: skip
    recording_read = softcal.Recording(**whole | {name: columns_of(whole[name])[kind]})
    assert recording_read.labelled.sha256 == softcal.Recording(**whole).labelled.sha256


@pytest.mark.parametrize("dtype", ["float32", "float16", "int16", "uint8", "Int64", "Float32", "int32[pyarrow]"])
def test_a_smaller_type_keeps_its_values(dtype):
    values = np.tile(np.arange(30.0), 20)
    recording = softcal.Recording(pd.Series(values).astype(dtype), sample_rate_Hz=50)
    np.testing.assert_array_equal(recording.output, values)
    assert recording.unlabelled.sha256 == softcal.Recording(values, sample_rate_Hz=50).unlabelled.sha256


def test_the_two_zeros_are_one_number(table):
    values = table["output"].to_numpy().copy()
    values[::50] = 0.0
    signed = np.where(values == 0, -0.0, values)
    one, other = (softcal.Recording(v, sample_rate_Hz=50).unlabelled.sha256 for v in (values, signed))
    assert one == other


@pytest.mark.parametrize(
    "values",
    [["0.5"] * N, np.array(["0.5"] * N), pd.Series(["0.5"] * N), [True] * N, np.ones(N, bool), [0.5, "0.6"] * 300,
     [0.5, True] * 300, np.ones(N, complex), pd.date_range("2026-01-01", periods=N, freq="20ms"),
     pd.to_timedelta(np.arange(N), unit="s"), np.ones((N, 1)), np.ones((N, 2)), [[0.5], [0.6, 0.7]], "0.5", 0.5, {0.5},
     {"a": 1}, (k for k in range(N)), pd.DataFrame({"output": np.ones(N)}), [object()] * N, [10**400] * N],
    ids=lambda values: str(type(values).__name__),
)  # fmt: skip
@pytest.mark.parametrize("name", ["output", "reference", "stage_mm"])
def test_a_column_of_no_numbers_is_refused_in_one_line(table, name, values):
    whole = {"output": table["output"], "sample_rate_Hz": 50} | {name: values}
    with pytest.raises(softcal.InputError, match=name) as refused:
        softcal.Recording(**whole)
    assert "\n" not in str(refused.value) and len(str(refused.value)) < 250


def test_series_under_other_labels_are_not_paired_by_their_position(table):
    shuffled = table.sample(frac=1.0, random_state=1)
    with pytest.raises(softcal.InputError, match="index"):
        softcal.Recording(table["output"], shuffled["reference"], sample_rate_Hz=50)
    softcal.Recording(table["output"], shuffled["reference"].to_numpy(), sample_rate_Hz=50)


def test_what_becomes_of_an_array_later_changes_no_recording(table):
    output, reference, t_s = (table[name].to_numpy().copy() for name in ("output", "reference", "t_s"))
    recording = softcal.Recording(output, reference, t_s=t_s)
    before, frame = recording.labelled.sha256, recording.to_frame()
    for values in (output, reference, t_s):
        values[:] = -1.0
    given_away = recording.to_frame()
    given_away["output"] = 7.0
    pd.testing.assert_frame_equal(recording.to_frame(), frame)
    assert replace(recording).labelled.sha256 == before
    for other in (copy.copy(recording), copy.deepcopy(recording), pickle.loads(pickle.dumps(recording))):
        assert other.labelled.sha256 == before


# Times


def times_of(t_s: np.ndarray) -> dict[str, object]:
    """The same times, in s from 0, as dates and durations."""
    seoul = timezone(timedelta(hours=9))
    start = datetime(2026, 10, 25, 0, 59, 58, 123000, tzinfo=UTC)
    durations = pd.to_timedelta(np.round(t_s * 1e9).astype("int64"))
    dates = pd.DatetimeIndex(pd.Timestamp(start) + durations)
    plain_dates = dates.tz_localize(None)
    return {
        "datetime64": plain_dates.to_numpy(),
        "datetime64 in ms": plain_dates.to_numpy().astype("datetime64[ms]"),
        "Series": pd.Series(plain_dates),
        "Series with zone": pd.Series(dates),
        # The clock goes back from summer time in the first seconds of these.
        "end of summer time": pd.Series(dates.tz_convert("Europe/Berlin")),
        "two offsets": [t.tz_convert("Europe/Berlin").to_pydatetime() for t in dates],
        "DatetimeIndex": dates,
        "datetime": [start + timedelta(microseconds=round(t * 1e6)) for t in t_s],
        "datetime with zone": np.array([start.astimezone(seoul) + timedelta(microseconds=round(t * 1e6)) for t in t_s]),
        "Timestamp": list(dates),
        "Arrow": pd.Series(plain_dates).astype("timestamp[us][pyarrow]"),
        "Arrow with zone": pd.Series(dates).astype("timestamp[ns, Asia/Seoul][pyarrow]"),
        "timedelta64": durations.to_numpy(),
        "Timedelta": pd.Series(durations),
        "TimedeltaIndex": durations,
        "timedelta": [timedelta(microseconds=round(t * 1e6)) for t in t_s],
        "Arrow duration": pd.Series(durations).astype("duration[ns][pyarrow]"),
    }


TIMES = list(times_of(np.arange(3) / 50))


@pytest.mark.parametrize("rate_Hz", [50, 500])
@pytest.mark.parametrize("kind", TIMES)
def test_dates_and_durations_become_exact_seconds(table, kind, rate_Hz):
    seconds = np.arange(N) / rate_Hz
    frame = table.assign(clock=times_of(seconds)[kind])
    recording = softcal.Recording.from_frame(frame, time_s="clock")
    np.testing.assert_array_equal(recording.t_s, seconds)
    assert recording.sample_rate_Hz == rate_Hz
    same = softcal.Recording(table["output"], table["reference"], t_s=times_of(seconds)[kind])
    assert same.labelled.sha256 == recording.labelled.sha256


@pytest.mark.parametrize("kind", ["DatetimeIndex", "TimedeltaIndex"])
def test_an_index_of_times_is_the_time(table, network, source, kind):
    seconds = np.arange(N) / 50
    indexed = table.drop(columns="t_s").set_index(times_of(seconds)[kind])
    recordings = [softcal.Recording.from_frame(indexed), softcal.Recording(indexed["output"], indexed["reference"])]
    recordings.append(softcal.Recording.from_frame(indexed, sample_rate_Hz=50))
    for recording in recordings:
        np.testing.assert_array_equal(recording.t_s, seconds)
        assert recording.sample_rate_Hz == 50.0
    assert (
        softcal.fit_network(source.drop(columns="t_s").set_index(indexed.index), **SMALL).network.id
        == network.network.id
    )
    unit = softcal.fit_map(network, indexed["output"])
    assert unit.sample_rate_Hz == 50.0 and unit.estimate(indexed["output"]).index.equals(indexed.index)


def test_a_gap_between_dates_stays_a_gap(table):
    seconds = np.arange(N) / 50 + 2.0 * (np.arange(N) >= 200)
    recording = softcal.Recording(table["output"], t_s=times_of(seconds)["Series with zone"], sample_rate_Hz=50)
    np.testing.assert_allclose(recording.t_s, seconds, atol=1e-12)
    assert len(recording.unlabelled.segments) == 2


def test_a_rate_is_checked_against_the_time_stamps(table):
    for rate_Hz in (25, 100):
        with pytest.raises(softcal.InputError, match=f"50 Hz.*{rate_Hz} Hz"):
            softcal.Recording.from_frame(table, sample_rate_Hz=rate_Hz)
        with pytest.raises(softcal.InputError, match=f"50 Hz.*{rate_Hz} Hz"):
            softcal.fit_network(table, sample_rate_Hz=rate_Hz, **SMALL)


def broken_times() -> dict[str, object]:
    dates = pd.Series(pd.date_range("2026-03-01", periods=N, freq="20ms"))
    missing = dates.copy()
    missing[7] = pd.NaT
    zoned = dates.dt.tz_localize("UTC")
    return {
        "goes back": pd.concat([dates[:300], dates[:300] + pd.Timedelta("1s")]),
        "wraps": pd.to_timedelta(np.arange(N) * 20 % 4096, unit="ms"),
        "repeats": dates.repeat(2)[:N],
        "missing": missing,
        "missing number": [0.0, None, *np.arange(2, N) / 50],
        "text": dates.astype(str),
        "text of numbers": [str(k / 50) for k in range(N)],
        "dates and numbers": [*dates[:300], *np.arange(300.0)],
        "zones and none": [*dates[:300], *zoned[300:]],
        "dates and durations": [*dates[:300], *(dates[300:] - dates[0])],
        "periods": pd.period_range("2026-03-01", periods=N, freq="s"),
        "days": [day.date() for day in pd.date_range("2026-03-01", periods=N)],
        "bools": [True, False] * 300,
        "too few": dates[:-1],
    }


def test_periods_are_no_instants_and_the_line_has_what_makes_them_such(network, table):
    periods = pd.period_range("2026-03-01", periods=N, freq="20ms")
    indexed = table[["output"]].set_index(periods)
    calls = [
        lambda: softcal.Recording(table["output"].to_numpy(), t_s=periods),
        lambda: softcal.Recording(table["output"].to_numpy(), t_s=pd.Series(periods)),
        lambda: softcal.Recording(table["output"].to_numpy(), t_s=list(periods)),
        lambda: softcal.Recording(indexed["output"], sample_rate_Hz=50),
        lambda: softcal.fit_map(network, indexed),
        lambda: softcal.fit_map(network, indexed.set_index(periods.astype(object))),
    ]
    for call in calls:
        with pytest.raises(softcal.InputError, match=r"t_s.*periods.*to_timestamp\(\)"):
            call()
    by_start = softcal.Recording.from_frame(indexed.to_timestamp())
    assert by_start.sample_rate_Hz == 50


def test_an_index_of_objects_that_are_times_is_the_time(table):
    stamps = pd.date_range("2026-03-01", periods=N, freq="20ms")
    indexed = table[["output"]].set_index(pd.Index(list(stamps), dtype=object))
    assert softcal.Recording.from_frame(indexed).t_s.tolist() == (np.arange(N) / 50).tolist()


@pytest.mark.parametrize("kind", broken_times())
def test_times_that_are_none_end_in_one_clear_line(table, kind):
    with pytest.raises(softcal.InputError, match="t_s") as refused:
        softcal.Recording(table["output"].to_numpy(), t_s=broken_times()[kind])
    assert "\n" not in str(refused.value) and len(str(refused.value)) < 200


# Missing samples


@pytest.mark.parametrize("missing", [float("nan"), None, pd.NA], ids=repr)
def test_missing_samples_are_masked_and_counted_and_no_fit_sees_them(network, table, missing):
    rows = [100, 101, 350]
    values = table["output"].astype(object)
    values[rows] = missing
    recording = softcal.Recording(values, sample_rate_Hz=50, serial="S2")
    assert len(recording) == N and recording.inspection.masked.counts["missing"] == 3
    assert np.isfinite(recording.unlabelled.output).all() and "3 masked" in repr(recording)
    assert np.flatnonzero(recording.to_frame()["output"].isna()).tolist() == rows
    unit = softcal.fit_map(network, recording)
    estimate = unit.estimate(recording)
    assert len(estimate) == N and (estimate["flag"][rows] == "invalid").all()
    whole = unit.estimate(table["output"])
    # A window that holds no missing sample reads as in the whole recording.
    clean = [k for k in range(14, N) if not set(rows) & set(range(k - 14, k + 1))]
    # Other rows beside it are summed in another order: one rounding of float32 of the sum's largest parts.
    read = estimate["estimate"].to_numpy()[clean]
    rounding = np.finfo(np.float32).eps * np.abs(read).max()
    np.testing.assert_allclose(read, whole["estimate"].to_numpy()[clean], rtol=0, atol=rounding)
    assert estimate["estimate"].drop(clean).isna().all()


def test_remarks_on_a_file_name_its_lines_and_those_on_arrays_their_rows(table, tmp_path):
    values = table["output"].to_numpy(copy=True)
    values[100] = 8388607
    path = tmp_path / "S2.csv"
    body = table.assign(output=values).to_csv(index=False)
    path.write_text(f"Logger 7\nstarted by hand\n{body}")
    (from_file,) = softcal.Recording.read(path).remarks
    (of_part,) = softcal.Recording.read(path)[50:400].remarks
    (from_arrays,) = softcal.Recording(values, sample_rate_Hz=50).remarks
    assert "line 104" in from_file and "line 104" in of_part and "row 101" in from_arrays


def test_a_missing_reference_is_no_missing_output(table):
    gapped = table.assign(reference=table["reference"].mask(table.index == 200))
    recording = softcal.Recording.from_frame(gapped)
    assert recording.unlabelled.sha256 == softcal.Recording.from_frame(table).unlabelled.sha256
    assert len(recording.labelled) == N - 1


# Tables and arrays straight into a fit


def test_a_table_with_other_names_and_arrays_train_the_same_network(source, network):
    renamed = source.rename(columns={"output": "V", "reference": "F", "t_s": "clock"})
    arrays = [source[name].to_numpy() for name in ("output", "reference")]
    for fitted in (
        softcal.fit_network(renamed, output="V", reference="F", time_s="clock", **SMALL),
        softcal.fit_network(*arrays, sample_rate_Hz=50, **SMALL),
        softcal.fit_network(arrays[0], reference=arrays[1], t_s=source["t_s"], **SMALL),
        softcal.fit_network(source["output"], source["reference"], sample_rate_Hz=50, **SMALL),
    ):
        assert fitted.network.id == network.network.id


def test_a_table_with_other_names_is_a_unit(network, table):
    unit = softcal.fit_map(network, table, serial="S2")
    renamed = table.rename(columns={"output": "V", "t_s": "clock"})
    other = softcal.fit_map(network, renamed, output="V", time_s="clock", serial="S2")
    assert other.recording.sha256 == unit.recording.sha256 and other.predicted_rmse == unit.predicted_rmse


@pytest.mark.parametrize(
    ("call", "needed"),
    [
        (lambda n, t: softcal.fit_network(t["output"], sample_rate_Hz=50), "fit_network.*reference="),
        (lambda n, t: softcal.fit_network(t[["t_s", "output"]]), "fit_network.*reference="),
        (lambda n, t: softcal.fit_network(softcal.Recording.from_frame(t[["t_s", "output"]])), "fit_network"),
        (lambda n, t: softcal.fit_map(n, t, audit=t["output"]), "audit.*fit_map.*reference="),
        (lambda n, t: softcal.fit_map(n, t).rmse(t["output"]), "Unit.rmse.*reference="),
        (lambda n, t: softcal.fit_network(t.rename(columns={"output": "V"})), "'output'.*t_s, V, reference.*output="),
        (lambda n, t: softcal.fit_network(t, reference="F"), "'F'.*reference="),
        (lambda n, t: softcal.fit_map(n, t, time_s="clock"), "'clock'.*time_s="),
        (lambda n, t: softcal.fit_map(n, pd.concat([t, t["output"]], axis=1)), "2 columns.*'output'"),
        (lambda n, t: softcal.fit_map(n, plain(t), sample_rate_Hz=50), "Recording already.*sample_rate_Hz"),
        (lambda n, t: softcal.fit_map(n, "S2.csv"), "Recording.read"),
        (lambda n, t: softcal.fit_map(n, {"output": t["output"], "t_s": t["t_s"]}), "DataFrame"),
        (lambda n, t: softcal.fit_map(n, []), "no unit"),
        (lambda n, t: softcal.fit_map(n, {}), "no unit"),
        (lambda n, t: softcal.Recording.from_frame([1, 2]), "DataFrame"),
    ],
)  # fmt: skip
def test_an_error_has_the_call_that_would_do_it(network, table, call, needed):
    with pytest.raises(softcal.InputError, match=needed) as refused:
        call(network, table)
    assert "\n" not in str(refused.value)


# Many units


@pytest.fixture(scope="module")
def units(press_unit) -> dict[str, pd.DataFrame]:  # type: ignore[no-untyped-def]
    return {f"S{k}": press_unit(N, 1 + 0.1 * k, 0.5, k) for k in (2, 3)}


def test_many_units_are_fitted_each_alone(network, units):
    fitted = softcal.fit_map(network, units)
    assert isinstance(fitted, softcal.UnitTable) and list(fitted) == ["S2", "S3"] and len(fitted) == 2
    frame = fitted.to_frame()
    assert frame["serial"].to_list() == ["S2", "S3"] and {"verdict", "predicted_rmse", "reasons"} <= set(frame)
    for serial, table in units.items():
        alone = softcal.fit_map(network, table, serial=serial)
        assert (fitted[serial].serial, fitted[serial].reasons) == (serial, alone.reasons)
        pd.testing.assert_frame_equal(fitted[serial].estimate(table), alone.estimate(table))
        pd.testing.assert_frame_equal(frame[frame["serial"] == serial].reset_index(drop=True), alone.to_frame())


def test_a_list_of_units_is_fitted_as_well(network, units):
    recordings = [softcal.Recording.from_frame(table, serial=serial) for serial, table in units.items()]
    by_list, by_dict = softcal.fit_map(network, recordings), softcal.fit_map(network, units)
    pd.testing.assert_frame_equal(by_list.to_frame(), by_dict.to_frame())
    mixed = softcal.fit_map(
        network, (recordings[0], units["S3"], units["S2"]["output"], units["S3"]["output"].to_list())
    )
    assert list(mixed) == ["S2", "unit-2", "unit-3", "unit-4"]


def test_a_unit_that_cannot_be_used_is_a_row_with_its_reason(network, units):
    good = units["S2"]
    fitted = softcal.fit_map(
        network,
        {
            "S2": good,
            "dead": np.full(N, 0.5),
            "short": [0.5, 0.6],
            "none": None,
            "file": "S9.csv",
            "text": ["0.5"] * N,
            "no name": good,
            7: good,
            "no-column": good.rename(columns={"output": "V"}),
            "other-unit": softcal.Recording(good["output"], sample_rate_Hz=50, output_unit="mV"),
            "other-rate": softcal.Recording(good["output"], sample_rate_Hz=100),
            "empty": [],
            "all-missing": [None] * N,
        },
    )
    rows = fitted.to_frame().set_index("serial")
    assert len(rows) == 13 and rows["verdict"]["dead"] == "fail" and rows["verdict"]["short"] == "retest"
    assert set(rows["verdict"].drop("S2")) <= {"retest", "fail"} and (rows["reasons"].str.len() > 10).all()
    assert rows["predicted_rmse"].dtype == float and rows["predicted_rmse"].drop("S2").isna().all()
    assert [unit.serial for unit in fitted.units] == ["S2"] and "dead" in fitted
    with pytest.raises(softcal.UnitRefused, match="short.*at least 15"):
        fitted["short"]
    with pytest.raises(softcal.InputError, match="'S8'.*S2"):
        fitted["S8"]


def test_units_of_one_serial_are_distinguished_before_they_are_fitted(network, units):
    good = softcal.Recording.from_frame(units["S2"])
    fitted = softcal.fit_map(network, [good, good, softcal.Recording.from_frame(units["S3"], serial="S3")])
    assert fitted.to_frame()["verdict"].to_list()[:2] == ["retest", "retest"] and fitted["S3"].verdict
    assert "serial=" in fitted.to_frame()["reasons"][0]


def test_audits_and_known_loads_of_many_units_are_given_by_serial(network, units):
    audits = {"S2": units["S2"]}
    fitted = softcal.fit_map(network, units, audit=audits, anchors={"S3": ([0.5], [0.0])}, limit_rmse=2)
    frame = fitted.to_frame().set_index("serial")
    assert np.isfinite(frame["after_rmse"]["S2"]) and np.isnan(frame["after_rmse"]["S3"])
    with pytest.raises(softcal.InputError, match="audit of S9"):
        softcal.fit_map(network, units, audit={"S9": units["S2"]})
    with pytest.raises(softcal.InputError, match="audit is.*dict by serial"):
        softcal.fit_map(network, units, audit=units["S2"])
    # A bad audit is a matter of its unit.
    assert softcal.fit_map(network, units, audit={"S2": [1, 2]}).to_frame()["verdict"][0] == "retest"


def test_an_audit_keeps_when_it_was_measured_through_every_file(network, units, tmp_path):
    at = datetime(2026, 5, 4, 9, 30, tzinfo=UTC)
    stamps = pd.date_range(at, periods=len(units["S2"]), freq="20ms")
    dated = units["S2"].drop(columns="t_s", errors="ignore").set_index(stamps)
    for audit in (dated, softcal.Recording.from_frame(units["S2"], serial="run-7", measured_at=at)):
        unit = softcal.fit_map(network, units["S2"], audit=audit, serial="S2", limit_rmse=2)
        unit.save(tmp_path / "S2.db")
        softcal.Unit.load(tmp_path / "S2.db").save(tmp_path / "again.db")
        for file in ("S2.db", "again.db"):
            with softcal.open_registry(f"sqlite:///{tmp_path / file}") as registry:
                (entry,) = registry.recordings.of_lot("python", "S2", "audit")
                assert (entry.observed_at, entry.sha256) == (at, unit.state.audit.recording_sha256)
                assert newest_audits(registry, "python") == {"S2": entry}
        assert softcal.Unit.load(tmp_path / "again.db").audited_at == at
    assert softcal.Recording.from_frame(dated)[100:200].measured_at == at + timedelta(seconds=2)
    dated.rename_axis("time").to_csv(tmp_path / "S2.csv")
    read = softcal.Recording.read(tmp_path / "S2.csv", time_s="time")
    assert read.measured_at == at and softcal.Recording(read.output, sample_rate_Hz=50).measured_at is None
    with pytest.raises(softcal.InputError, match="measured_at is.*yesterday"):
        softcal.Recording(read.output, sample_rate_Hz=50, measured_at="yesterday")


def test_a_wrong_argument_of_the_call_is_refused_before_any_unit(network, units):
    for wrong in ({"family": "affin"}, {"limit_rmse": "2"}, {"limit_rmse": -1}, {"serial": "S2"}):
        with pytest.raises(softcal.InputError):
            softcal.fit_map(network, units, **wrong)


@pytest.mark.parametrize(
    "options", [{"sample_rate_Hz": 50}, {"output_unit": "V"}, {"sample_rate_Hz": 50, "stage_mm": 1}]
)
def test_a_recording_among_units_takes_no_option_of_the_call(network, units, options):
    recording = plain(units["S2"])
    for units_given in (
        {"A": recording},
        {"B": units["S3"]["output"], "A": recording},
        [units["S3"]["output"], recording],
    ):
        with pytest.raises(softcal.InputError, match=r"a Recording already.*softcal\.Recording\(") as refused:
            softcal.fit_map(network, units_given, **options)
        assert str(refused.value).startswith("unit " if isinstance(units_given, list) else "A ")
        assert all(f"{name}=" in str(refused.value) for name in options) and "\n" not in str(refused.value)
    softcal.fit_map(network, {"A": recording, "B": units["S3"]["output"]})


@pytest.mark.parametrize("options", [{"sample_rate_Hz": -50}, {"sample_rate_Hz": "fast"}, {"output_unit": 5}])
def test_an_option_that_no_unit_can_have_is_refused_before_any_unit(network, units, options):
    with pytest.raises(softcal.InputError, match=next(iter(options))):
        softcal.fit_map(network, {"A": units["S2"]["output"].to_numpy()}, **options)


# Slices, tables, figures


def test_a_slice_is_the_same_stretch_of_every_column(table):
    recording = softcal.Recording.from_frame(table.assign(stage_mm=table["reference"] / 2), serial="S2")
    whole = recording.to_frame()
    for rows in (slice(0, 100), slice(100, None), slice(-50, None), slice(None, 20), slice(None)):
        part = recording[rows]
        pd.testing.assert_frame_equal(part.to_frame(), whole[rows].reset_index(drop=True))
        assert (part.serial, part.sample_rate_Hz) == ("S2", 50.0)
    part = recording.between(2.0, 10.0)
    assert (part.t_s[0], part.t_s[-1], len(part)) == (2.0, 10.0, 401)
    pd.testing.assert_frame_equal(recording.between(np.float32(0), 4).to_frame(), recording[:201].to_frame())


@pytest.mark.parametrize("rows", [5, slice(None, None, 2), slice(None, None, -1), slice(0.0, 2.0), slice(3, 8),
                                  slice(8, 3), "output", [1, 2], np.ones(N, bool)], ids=str)  # fmt: skip
def test_what_is_no_stretch_is_refused_in_one_line(table, rows):
    with pytest.raises(softcal.InputError):
        softcal.Recording.from_frame(table)[rows]


@pytest.mark.parametrize("bounds", [(10, 2), (20, 30), ("2", 10), (2, None), (float("nan"), 3), (1.0, 1.1)], ids=str)
def test_a_stretch_of_time_without_samples_is_refused(table, bounds):
    with pytest.raises(softcal.InputError):
        softcal.Recording.from_frame(table).between(*bounds)


def test_a_part_of_a_unit_can_be_fitted_and_the_rest_audits_it(network, table):
    recording = softcal.Recording.from_frame(table, serial="S2")
    unit = softcal.fit_map(network, recording[:400], audit=recording.between(8.0, 12.0))
    assert unit.state.scores is not None and unit.recording.t_s[-1] == recording.t_s[399]


def test_a_recording_goes_to_a_table_and_back(table):
    recording = softcal.Recording.from_frame(table)
    again = softcal.Recording.from_frame(recording.to_frame())
    assert again.labelled.sha256 == recording.labelled.sha256
    names = table.rename(columns={"output": "V", "reference": "F"})
    assert softcal.Recording.from_frame(names, output="V", reference="F").labelled.sha256 == recording.labelled.sha256


def test_figures_draw_the_numbers_of_the_recording_and_of_the_unit(network, table):
    recording = softcal.Recording.from_frame(table.assign(output=table["output"].mask(table.index == 9)), serial="S2")
    output, reference = recording.plot().data
    np.testing.assert_array_equal(output.y, recording.output)
    np.testing.assert_array_equal(reference.y, table["reference"])
    unit = softcal.fit_map(network, recording)
    estimate = unit.estimate(recording)
    for argument in (recording, table["output"], None):
        figure = unit.plot() if argument is None else unit.plot(argument)
        traces = {trace.name: trace for trace in figure.data}
        assert {"unit, mapped", "loading", "unloading", "90 % interval", "estimate"} <= set(traces)
    figure = {trace.name: trace for trace in unit.plot(recording).data}
    rows = recording.rows
    np.testing.assert_array_equal(figure["estimate"].y, estimate["estimate"].to_numpy()[rows])
    np.testing.assert_array_equal(figure["90 % interval"].y, estimate["lower"].to_numpy()[rows])
    loads = np.concatenate([figure["loading"].x, figure["unloading"].x])
    np.testing.assert_array_equal(np.sort(loads), np.sort(table["reference"].to_numpy()[rows]))


def test_a_figure_without_plotly_names_the_extra_in_one_line():
    code = (
        "import sys; sys.modules['plotly'] = None\n"
        "import softcal\n"
        "try:\n    softcal.Recording([0.5, 0.6, 0.7] * 10, sample_rate_Hz=50).plot()\n"
        "except ModuleNotFoundError as error:\n    print(error)"
    )
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (
        "Recording.plot" in process.stdout
        and "pip install 'softcal[" in process.stdout
        and process.stdout.count("\n") == 1
    )


def test_everything_shows_itself_in_one_short_line_and_in_a_notebook(network, units):
    fitted = softcal.fit_map(network, {**units, "short": [0.5]})
    for thing, names in (
        (network, ("N", "15-8-1")),
        (softcal.Recording.from_frame(units["S2"], serial="S2"), ("S2", "600", "50 Hz")),
        (fitted["S2"], ("S2", fitted["S2"].verdict)),
        (fitted, ("3", "1 retest")),
    ):
        assert len(repr(thing)) < 120 and all(name in repr(thing) for name in names)
        page = thing._repr_html_()
        assert page.count("<table") == 1 and "short" in fitted._repr_html_()
    assert (
        "<b>" not in softcal.Recording([0.5] * 20, sample_rate_Hz=50, output_unit="<b>")._repr_html_().split("<tr>")[2]
    )


def test_a_file_that_was_read_is_typed_like_a_table(table, tmp_path):
    table.to_csv(tmp_path / "S2.csv", index=False)
    recording = softcal.Recording.read(tmp_path / "S2.csv", sample_rate_Hz=np.float32(50))
    assert (
        recording.labelled.sha256
        == softcal.Recording.from_frame(pd.read_csv(tmp_path / "S2.csv"), serial="S2").labelled.sha256
    )


@pytest.mark.parametrize("step", [1, 2, 4])
def test_whole_numbers_of_ms_are_no_seconds_in_python_either(step: int) -> None:
    output = 0.5 + 0.1 * np.sin(np.arange(200) / 9)
    with pytest.raises(softcal.InputError, match=r"t_s \(0, .*is it in .*ms.*sample_rate_Hz="):
        softcal.Recording(output, t_s=np.arange(200) * step)
    confirmed = softcal.Recording(output, t_s=np.arange(200) * step, sample_rate_Hz=1 / step)
    assert confirmed.t_s[-1] == 199 * step
    by_date = softcal.Recording(output, t_s=pd.date_range("2026-03-01", periods=200, freq=f"{step}s"))
    assert by_date.sample_rate_Hz == pytest.approx(1 / step)


def test_columns_of_objects_are_times_too() -> None:
    output, stamps = 0.5 + 0.1 * np.sin(np.arange(200) / 9), pd.date_range("2026-03-01", periods=200, freq="20ms")
    dates = pd.Series(stamps.to_pydatetime().tolist(), dtype=object)
    spans = pd.Series((stamps - stamps[0]).to_pytimedelta().tolist(), dtype=object)
    for times in (dates, spans, dates.tolist(), spans.tolist()):
        assert softcal.Recording(output, t_s=times).t_s.tolist() == pytest.approx((np.arange(200) / 50).tolist())


def test_a_time_that_goes_back_all_along_is_said_to() -> None:
    with pytest.raises(softcal.InputError, match="t_s goes back"):
        softcal.Recording(np.linspace(0, 1, 200), t_s=pd.date_range("2026-03-01", periods=200, freq="20ms")[::-1])
