"""One look at a recording finds what loggers and loose cables leave in it, and takes nothing good for a fault."""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.core.errors import InputError
from softcal.core.inspection.build import InspectedRecording, build_recording
from softcal.core.inspection.config import DropoutConfig, InspectionConfig
from softcal.core.inspection.levels import find_flat_ends
from softcal.core.inspection.reasons import check_reference
from softcal.core.recording import Array
from softcal.core.unit.method import Method
from softcal.core.unit.missing import jump_findings, missing_findings, missing_samples

PressUnit = Callable[[int, float, float, int], pd.DataFrame]
RATE_HZ = 50.0


def inspected(
    output: Array, reference: Array | None = None, t_s: Array | None = None, rate_Hz: float = RATE_HZ
) -> InspectedRecording:
    t_s = np.arange(len(output)) / rate_Hz if t_s is None else t_s
    return build_recording("U1", t_s, output, sample_rate_Hz=rate_Hz, reference=reference, config=InspectionConfig())


def measured_outputs(folder: Path) -> Iterator[tuple[str, Array, float]]:
    """Yield every measured output with its rate."""
    for name in ("S1", "S2"):
        yield name, pd.read_csv(folder / f"egain_pair/{name}.csv")["output_V"].to_numpy(), 50.0
    for name in ("calibration", "validation_1"):
        table = pd.read_parquet(folder / f"insole_lot/{name}.parquet")
        for taxel in [column for column in table.columns if column.startswith("taxel")]:
            yield f"{name} {taxel}", table[taxel].to_numpy(float), 48.9
    for path in sorted((folder / "nylon_drift").glob("*.parquet")):
        yield path.stem, pd.read_parquet(path)["output_R_over_R0"].to_numpy(), 10.0
    for path in sorted((folder / "skin_places").glob("*.parquet")):
        yield path.stem, pd.read_parquet(path)["output_V"].to_numpy(), 50.0


def labelled_pairs(folder: Path) -> Iterator[tuple[str, Array, Array]]:
    """Yield measured outputs with the force beside them, 50 Hz."""
    for path in sorted([*(folder / "egain_pair").glob("*.csv"), *(folder / "skin_places").glob("*.parquet")]):
        table = pd.read_csv(path) if path.suffix == ".csv" else pd.read_parquet(path)
        yield path.stem, table["output_V"].to_numpy(), table["force_N"].to_numpy()


SPIKES: dict[str, Callable[[Array], Array]] = {
    "zero": lambda run: 0 * run,
    "half": lambda run: run / 2,
    "rail": lambda run: 0 * run + 5.0,
}
"""What a loose cable leaves of an output in volts."""


def planted(output: Array, kind: str, length: int, rng: np.random.Generator, count: int = 5) -> tuple[Array, list[int]]:
    """Return an output with spikes, and the rows that were changed."""
    faulty = output.copy()
    starts = rng.choice(np.arange(20, len(output) - 20, 25), count, replace=False) + rng.integers(0, 20)
    for start in starts:
        faulty[start : start + length] = SPIKES[kind](output[start : start + length])
    return faulty, [int(start) + k for start in starts for k in range(length)]


def masked_rows(result: InspectedRecording, samples: int) -> set[int]:
    return set(range(samples)) - set(result.rows.tolist())


def test_of_measured_recordings_hardly_a_good_sample_is_masked(measured_data: Path) -> None:
    samples = masked = 0
    for _, output, rate_Hz in measured_outputs(measured_data):
        samples, masked = samples + len(output), masked + len(inspected(output, rate_Hz=rate_Hz).inspection.masked)
    assert samples > 1_000_000
    assert masked <= 1e-4 * samples


@pytest.mark.parametrize("kind", SPIKES)
@pytest.mark.parametrize("length", [1, 2, 3])
def test_a_loose_cable_is_found_and_its_neighbours_stay(
    kind: str, length: int, press_unit: PressUnit, measured_data: Path, rng: np.random.Generator
) -> None:
    outputs = [press_unit(1500, 1 + 0.2 * k, 0.5, k)["output"].to_numpy() for k in range(8)]
    outputs += [output for name, output, _ in measured_outputs(measured_data) if name in ("S1", "S2")]
    changed = found_count = wrong = samples = 0
    for output in outputs:
        faulty, rows = planted(output, kind, length, rng)
        masked = masked_rows(inspected(faulty), len(output))
        changed, found_count = changed + len(rows), found_count + len(masked & set(rows))
        wrong, samples = wrong + len(masked - set(rows)), samples + len(output)
    assert found_count >= 0.99 * changed
    assert wrong <= 1e-4 * samples


def test_a_halved_output_is_found_between_fast_presses_where_it_dips_deeper_than_they_do(
    measured_data: Path, rng: np.random.Generator
) -> None:
    outputs = [output for name, output, _ in measured_outputs(measured_data) if name in ("left", "middle", "right")]
    changed = found_count = wrong = samples = 0
    for output, length, _ in itertools.product(outputs, (1, 2, 3), range(15)):
        span = float(np.ptp(np.quantile(output, (0.01, 0.99))))
        faulty, rows = planted(output, "half", length, rng)
        masked = masked_rows(inspected(faulty), len(output))
        for start in rows[::length]:
            run = faulty[start : start + length]
            # Between their peaks measured presses dip by 9 % of the range themselves.
            if min(faulty[start - 1], faulty[start + length]) - run.max() >= 0.12 * span:
                changed, found_count = changed + 1, found_count + (set(range(start, start + length)) <= masked)
        wrong, samples = wrong + len(masked - set(rows)), samples + len(output)
    assert changed > 300
    assert found_count >= 0.99 * changed
    assert wrong <= 1e-4 * samples


def test_spikes_of_a_coarse_converter_hide_no_good_sample_behind_their_finer_steps(
    measured_data: Path, rng: np.random.Generator
) -> None:
    outputs = [output for name, output, _ in measured_outputs(measured_data) if name.startswith("calibration")]
    found_count = changed = wrong = samples = 0
    for output in outputs[::4]:
        faulty, rows = planted(output, "half", 3, rng)
        usual, masked = masked_rows(inspected(output), len(output)), masked_rows(inspected(faulty), len(output))
        changed, found_count = changed + len(rows), found_count + len(masked & set(rows))
        wrong, samples = wrong + len(masked - usual - set(rows)), samples + len(output)
    assert found_count == changed
    assert wrong <= 2e-5 * samples


@pytest.mark.parametrize("apart", [2, 3, 4])
@pytest.mark.parametrize("level", [1.5, -1.0])
@pytest.mark.parametrize("side", [1, -1])
def test_between_two_spikes_that_lie_close_the_good_samples_are_left(apart: int, level: float, side: int) -> None:
    # Taps to one side: what leaves to the other one is the more unusual.
    t_s = np.arange(1500) / 50
    taps = np.exp(-(((t_s % 1.0 - 0.5) / 0.1) ** 2))
    for seed in range(10):
        rng = np.random.default_rng(seed)
        output = 0.4 + side * 0.2 * taps + rng.normal(0.0, 0.002, len(t_s))
        first = int(rng.integers(4, 28)) * 50 + 2
        output[[first, first + apart]] = level
        assert masked_rows(inspected(output), len(output)) == {first, first + apart}


@pytest.mark.parametrize("length", [1, 2, 3])
def test_more_spikes_than_the_usual_movements_are_found_too(
    length: int, press_unit: PressUnit, rng: np.random.Generator
) -> None:
    output = press_unit(1500, 1.0, 0.5, 3)["output"].to_numpy()
    faulty, rows = planted(output, "zero", length, rng, count=15)
    assert masked_rows(inspected(faulty), len(output)) == set(rows)


@pytest.mark.parametrize("code", [8388607.0, -8388608.0, 9.9e37, -9999.0, 32767.0, 2147483647.0, np.inf, 1e9])
@pytest.mark.parametrize("count", [1, 40])
def test_values_that_loggers_write_instead_of_a_sample_are_masked(
    code: float, count: int, press_unit: PressUnit, rng: np.random.Generator
) -> None:
    output = press_unit(1500, 1.0, 0.5, 3)["output"].to_numpy(copy=True)
    rows = rng.choice(1500, count if abs(code) != 1e9 else 1, replace=False)
    output[rows] = code
    result = inspected(output)
    assert masked_rows(result, 1500) == set(rows.tolist())
    assert result.inspection.masked.counts == {"overflow": len(rows)}
    assert {one.value for one in result.inspection.of_kind("overflow")} == {code}


def test_a_code_beyond_all_ranges_leaves_finite_numbers(press_unit: PressUnit) -> None:
    output = press_unit(1500, 1.0, 0.5, 3)["output"].to_numpy(copy=True)
    output[700] = np.finfo(float).max
    (overflow,) = inspected(output).inspection.of_kind("overflow")
    assert overflow.start == 700 and np.isfinite(overflow.amount)


def test_a_recording_of_every_programme_without_noise_is_left_as_it_is() -> None:
    t_s = np.arange(3000) / RATE_HZ
    square, taps = (t_s % 4 < 2).astype(float), (t_s % 1 < 0.1).astype(float)
    creep = np.where(t_s > 20, 1 - np.exp(-(t_s - 20) / 5), 0.0)
    coarse = np.round(50 * np.sin(t_s)) / 50
    for output in (square, taps, creep, coarse, np.sin(t_s) ** 8, np.cumsum(taps)):
        assert len(inspected(output).inspection.masked) == 0


def test_a_slow_logger_may_see_a_press_in_one_sample() -> None:
    t_s = np.arange(600.0)
    press_levels = (np.arange(600) % 30 == 7).astype(float)
    assert (
        len(build_recording("U1", t_s, press_levels, sample_rate_Hz=1.0, config=InspectionConfig()).inspection.masked)
        == 0
    )


def test_a_cable_that_is_off_for_a_second_is_masked_as_a_whole(press_unit: PressUnit) -> None:
    output = press_unit(1500, 1.0, 0.5, 3)["output"].to_numpy(copy=True)
    output[700:750] = 0.0
    result = inspected(output)
    assert masked_rows(result, 1500) == set(range(700, 750))
    (dropout,) = result.inspection.of_kind("dropout")
    assert (dropout.start, dropout.stop, dropout.value) == (700, 750, 0.0)


def test_missing_cells_leave_a_gap_and_travel_with_the_recording(press_unit: PressUnit) -> None:
    table = press_unit(1500, 1.0, 0.5, 3)
    output, reference = table["output"].to_numpy(), table["reference"].to_numpy(copy=True)
    faulty = output.copy()
    faulty[[10, 11, 800]], reference[900] = np.nan, np.nan
    result = inspected(faulty, reference)
    assert result.recording.masked.counts == {"missing": 3, "no_reference": 1}
    assert result.reference is not None and len(result.reference) == len(result.recording) == 1496
    assert np.array_equal(result.recording.output, np.delete(output, [10, 11, 800, 900]))
    assert len(result.recording.segments) == 4
    assert result.recording.part(0, 100).masked.counts == {"missing": 2}
    assert result.recording.sha256 != inspected(output).recording.sha256


def test_a_recording_without_faults_is_hashed_as_before(press_unit: PressUnit) -> None:
    recording = inspected(press_unit(1500, 1.0, 0.5, 3)["output"].to_numpy()).recording
    assert set(recording.arrays()) == {"t_s", "output"}


@pytest.mark.parametrize(("t_s", "message"), [([0, 0.02, 0.02], "repeats"), ([0, 0.04, 0.02], "backward")])
def test_time_that_goes_back_stays_an_error_beside_masks(t_s: list[float], message: str) -> None:
    times = np.concatenate([t_s, 1 + np.arange(50) / RATE_HZ])
    output = np.linspace(0, 1, len(times))
    output[1] = np.nan
    with pytest.raises(InputError, match=message):
        inspected(output, t_s=times)


def test_gaps_are_counted_in_samples_and_seconds(press_unit: PressUnit) -> None:
    output, rows_kept = press_unit(1500, 1.0, 0.5, 3)["output"].to_numpy(), np.r_[0:500, 600:1500]
    inspection = inspected(output[rows_kept], t_s=rows_kept / RATE_HZ).inspection
    (gap,) = inspection.of_kind("gap")
    assert (gap.start, gap.amount) == (500, 100)
    assert gap.value == pytest.approx(2.02)
    # Both ends of the gap lose a window's length less one.
    assert inspection.window_share == pytest.approx((486 + 886) / 1386)


def test_another_rate_in_a_part_is_no_row_of_gaps(press_unit: PressUnit) -> None:
    output, rows_kept = press_unit(1500, 1.0, 0.5, 3)["output"].to_numpy(), np.r_[0:1000, 1000:1500:5]
    inspection = inspected(output[rows_kept], t_s=rows_kept / RATE_HZ).inspection
    (slow,) = inspection.of_kind("rate")
    assert slow.value == pytest.approx(10.0) and slow.start in range(995, 1003)
    assert inspection.of_kind("gap") == () and len(inspection.masked) == 0


@pytest.mark.parametrize("late_s", [0.2, 0.5, 1.0, -0.5])
def test_a_late_reference_is_distinguished_from_relaxation(late_s: float, measured_data: Path) -> None:
    for name, output, force_N in labelled_pairs(measured_data):
        rows = round(abs(late_s) * RATE_HZ)
        early, late = slice(rows, None), slice(None, len(output) - rows)
        pair = (output[early], force_N[late]) if late_s > 0 else (output[late], force_N[early])
        (lag,) = inspected(*pair).inspection.of_kind("lag")
        assert lag.value == pytest.approx(late_s, abs=0.05), name
        assert inspected(output, force_N).inspection.of_kind("lag", "tare", "held") == (), name


@pytest.mark.parametrize("late_s", [0.5, -0.5])
def test_a_lag_is_not_taken_for_half_a_period_of_a_programme_that_repeats_itself(late_s: float) -> None:
    t_s = np.arange(1500) / RATE_HZ
    force = 6 * np.abs(np.sin(2 * np.pi * t_s / 7)) ** 1.5
    output = 0.5 + 0.05 * force + 0.006 * np.convolve(force, np.ones(15) / 15)[:1500]
    shift = round(late_s * RATE_HZ)
    (lag,) = inspected(output[100:-100], np.roll(force, shift)[100:-100]).inspection.of_kind("lag")
    assert lag.value == pytest.approx(late_s, abs=0.06)


@pytest.mark.parametrize("share", [0.3, -0.3])
def test_a_tare_in_the_middle_is_found_where_it_is(share: float, measured_data: Path) -> None:
    located = trials = 0
    sizes: list[float] = []
    for _, output, force_N in labelled_pairs(measured_data):
        for part in (0.25, 0.4, 0.5, 0.6, 0.75):
            row, tared = int(part * len(output)), force_N.copy()
            tared[row:] += share * np.ptp(force_N)
            finding = [one for one in inspected(output, tared).inspection.of_kind("tare") if one.start == row]
            located, trials = located + len(finding), trials + 1
            sizes += [one.value / (share * np.ptp(force_N)) for one in finding]
    assert located >= 0.8 * trials
    assert np.median(np.abs(np.array(sizes) - 1)) < 0.1


def slow_programme(rng: np.random.Generator) -> tuple[Array, Array]:
    """Return output and reference of slow ramps: the output lags in a loop and drifts by a part of its range."""
    turns = np.cumsum(rng.integers(100, 400, 20))
    load = np.interp(np.arange(turns[-1]), turns, np.where(np.arange(20) % 2, rng.uniform(2, 5, 20), 0.2))
    follows = np.concatenate([[load[0]], load[0] + np.cumsum(np.diff(load) * rng.uniform(0.6, 1.0))])
    drift = rng.uniform(-1, 1) * np.linspace(0, 1, len(load)) ** rng.uniform(0.5, 2)
    return 0.8 * load + 0.2 * follows + drift + rng.normal(0, 0.02, len(load)), load + rng.normal(0, 0.003, len(load))


@pytest.mark.parametrize("seed", range(12))
def test_a_tare_is_found_beside_an_output_that_drifts(seed: int) -> None:
    rng = np.random.default_rng(seed)
    output, load = slow_programme(rng)
    assert not inspected(output, load).inspection.of_kind("tare")
    for share in (-0.15, 0.15):
        row, tared = int(rng.uniform(0.15, 0.85) * len(load)), load.copy()
        tared[row:] += share * np.ptp(load)
        assert [one.start for one in inspected(output, tared).inspection.of_kind("tare")] == [row]


@pytest.mark.parametrize("seed", range(12))
def test_a_load_that_jumps_is_no_tare(seed: int) -> None:
    rng = np.random.default_rng(seed)
    output, load = slow_programme(rng)
    # A weight that was put down within one sample; a slow sensor follows in seconds.
    row = int(rng.uniform(0.3, 0.7) * len(load))
    load[row:] += 2.0
    output[row:] += 2.0 * (1 - np.exp(-np.arange(len(load) - row) / rng.uniform(1, 60)))
    assert not inspected(output, load).inspection.of_kind("tare")


def test_the_line_of_an_unusable_reference_is_named(press_unit: PressUnit) -> None:
    table = press_unit(1500, 1.0, 0.5, 3)
    output, force_N = table["output"].to_numpy(), table["reference"].to_numpy()
    tared, sampled_N = force_N.copy(), force_N[np.arange(1500) // 6 * 6]
    tared[700:] -= 1.0
    with pytest.raises(InputError, match="line 702 .*tared"):
        check_reference(inspected(output, tared).inspection, np.arange(1500) + 2)
    with pytest.raises(InputError, match="8.33 Hz"):
        check_reference(inspected(output, sampled_N).inspection)
    with pytest.raises(InputError, match="never changes"):
        check_reference(inspected(output, 0 * force_N).inspection)
    check_reference(inspected(output, force_N).inspection)


def test_a_baseline_that_jumps_and_a_counter_that_wraps_are_distinguished(press_unit: PressUnit) -> None:
    output = press_unit(1500, 1.0, 0.5, 3)["output"].to_numpy()
    counts = np.round(30000 + 10000 * (output - 0.5) / np.ptp(output))
    stepped, wrapped = output.copy(), (counts + 32768) % 65536 - 32768
    stepped[800:] += 0.5 * np.ptp(output)
    (step,) = inspected(stepped).inspection.of_kind("step", "wrap")
    assert (step.kind, step.start) == ("step", 800)
    assert {one.kind for one in inspected(wrapped).inspection.of_kind("step", "wrap")} == {"wrap"}
    assert inspected(output).inspection.findings == ()


def test_a_reading_that_stands_still_in_a_press_is_found(press_unit: PressUnit) -> None:
    output = press_unit(1500, 1.0, 0.5, 3)["output"].to_numpy(copy=True)
    middle = int(np.argmin(np.abs(output[100:900] - np.quantile(output, 0.6)))) + 100
    output[middle : middle + 250] = output[middle]
    (stuck,) = inspected(output).inspection.of_kind("stuck")
    assert (stuck.start, stuck.stop) == (middle, middle + 250)


@pytest.mark.parametrize("seconds", [3.0, 9.0, None])
@pytest.mark.parametrize("part", [0.2, 0.5])
def test_a_reference_that_stands_still_while_the_output_is_pressed_is_named(
    part: float, seconds: float | None, measured_data: Path
) -> None:
    for name, output, force_N in labelled_pairs(measured_data):
        row, still = int(part * len(output)), force_N.copy()
        stop = len(output) if seconds is None else row + round(seconds * RATE_HZ)
        still[row:stop] = still[row]
        finding = inspected(output, still).inspection.of_kind("stuck")
        pressed_share = np.ptp(np.quantile(output[row:stop], (0.05, 0.95))) / np.ptp(np.quantile(output, (0.01, 0.99)))
        if pressed_share > 0.6:
            assert [(one.start, one.stop, one.column) for one in finding] == [(row, stop, "reference")], name
            with pytest.raises(InputError, match=f"line {row + 2} .*reference: it stands still.*channel"):
                check_reference(inspected(output, still).inspection, np.arange(len(output)) + 2)
        assert inspected(output, force_N).inspection.of_kind("stuck") == (), name


def test_a_load_cell_that_counts_compression_negative_is_named_and_not_corrected(press_unit: PressUnit) -> None:
    table = press_unit(1500, 1.0, 0.5, 3)
    result = inspected(table["output"].to_numpy(), -table["reference"].to_numpy())
    assert result.inspection.of_kind("sign")
    assert result.reference is not None and np.array_equal(result.reference, -table["reference"].to_numpy())


def test_what_decides_about_a_jump_of_a_unit_stands_in_the_method_that_is_hashed(press_unit: PressUnit) -> None:
    output = press_unit(1500, 1.0, 0.5, 3)["output"].to_numpy(copy=True)
    output[800:] += 0.5 * np.ptp(output)
    recording, usual = inspected(output).recording, Method()
    deaf = replace(usual, inspection=replace(usual.inspection, step_share=1.0))
    assert [one.reason.code for one in jump_findings(recording, usual.inspection)] == ["stepped"]
    assert jump_findings(recording, deaf.inspection) == () and deaf.id != usual.id


@pytest.mark.parametrize("part", [0.6, 0.8])
def test_an_output_that_is_cut_off_is_named_and_measured_ones_are_not(part: float, measured_data: Path) -> None:
    for number, (_, output, rate_Hz) in enumerate(measured_outputs(measured_data)):
        assert find_flat_ends(output, InspectionConfig()) == []
        if number % 8:
            continue
        low, high = np.quantile(output, (0.01, 0.99))
        is_rising = np.median(output[:50]) < (low + high) / 2
        level = low + part * (high - low) if is_rising else high - part * (high - low)
        clipped = np.minimum(output, level) if is_rising else np.maximum(output, level)
        (finding,) = inspected(clipped, rate_Hz=rate_Hz).inspection.of_kind("clipped")
        assert (finding.value, finding.amount) == (level, pytest.approx(np.count_nonzero(clipped == level), rel=0.01))
        assert clipped[finding.start] == level


def test_what_is_masked_is_decided_by_the_configuration_that_is_given(press_unit: PressUnit) -> None:
    output = press_unit(1500, 1.0, 0.5, 3)["output"].to_numpy(copy=True)
    output[700] = 5.0
    t_s = np.arange(len(output)) / 50
    deaf = replace(InspectionConfig(), spike_share=1e9, dropout=DropoutConfig(edge_steps=1e9))
    counts = [
        len(build_recording("U", t_s, output, sample_rate_Hz=50.0, config=config).inspection.masked)
        for config in (InspectionConfig(), deaf)
    ]
    assert counts == [1, 0]


@pytest.mark.parametrize(("start_s", "kind"), [(8.0, "pause"), (9.0, "gap")])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_pause_at_rest_is_distinguished_from_lost_samples(start_s: float, kind: str, sign: float) -> None:
    # Presses of 2 s, 2 s apart; the logger stands still for a minute at rest, or loses samples in a press.
    t_s = np.arange(2000) / 50
    output = 1 + sign * np.maximum(np.sin(np.pi * (t_s - 0.5) / 2), 0) * (t_s % 4 < 2.5)
    paused = t_s + 60.0 * (t_s >= start_s)
    result = inspected(output, t_s=paused)
    (pause,) = result.inspection.of_kind("pause", "gap")
    assert (pause.kind, pause.start, round(pause.value)) == (kind, round(start_s * 50), 60)
    method = Method()
    missing = missing_samples(result.recording, method.inspection)
    (finding,) = missing_findings(result.recording, method)
    assert (missing.share < 0.01, finding.reason.code) == (
        (True, "paused") if kind == "pause" else (False, "samples_missing")
    )
