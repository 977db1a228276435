"""The correction by a check standard: the source unit, pressed again in the sitting of the units.

A unit and the golden unit that met one load at one time differ by what the units differ by, and by nothing that the day
or the programme does to both. The map of the unit is therefore fitted to the golden run in place of the source's
recording. What the day does to the golden unit itself is a gain and a zero, fitted where a load cell was under it.

A unit of the lot that was pressed under the load cell gives its sitting's loads as well: what the source would show of
them is read off f.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from softcal.core.errors import InputError
from softcal.core.inspection.comparison import compare_recordings
from softcal.core.maps.affine_map import AffineMap
from softcal.core.maps.synchrony import find_synchrony
from softcal.core.metrics import rmse
from softcal.core.network.network import Network
from softcal.core.recording import Array, Indices, LabelledRecording, OutputRecording
from softcal.core.unit.method import LEVELS, Method
from softcal.core.unit.source_model import SourceModel
from softcal.core.windows import evenly, resting

SAME_DAY = AffineMap(1.0, 0.0, "identity")


@dataclass(frozen=True, eq=False)
class DayCorrection:
    """The correction that a golden run gives the units of its sitting, which are compared with it.

    Args:
        golden: the run, as the source would show it on its own day, with its reference: measured, or what f reads where
            no load cell was under it.
        day_map: gain and zero of that day's output on the source's.
        day_rmse: RMS change of the estimates that the day makes, in the reference unit; 0 where it was not measured.
        reference_rmse: RMS error of `golden`'s reference, in the same.
    """

    golden: LabelledRecording
    day_map: AffineMap
    day_rmse: float
    reference_rmse: float
    is_measured: bool
    run_sha256: str

    @property
    def sha256(self) -> str:
        """Content hash of what units are compared with."""
        return self.golden.sha256


def fit_day_correction(model: SourceModel, run: OutputRecording | LabelledRecording) -> DayCorrection:
    """Return the day correction that a golden run gives, as f reads it.

    Args:
        run: the source unit pressed in the units' sitting, with a reference where a load cell was under it; or a unit
            of the lot with its reference.

    Raises:
        InputError: it is of another unit and has no reference, is the source's own recording, or f cannot read it.
    """
    recording = run.unlabelled if isinstance(run, LabelledRecording) else run
    source, method = model.source, model.method
    if recording.serial != source.serial and isinstance(run, LabelledRecording):
        return _correct_by_unit(model, run)
    if recording.serial != source.serial:
        raise InputError(
            f"golden run of {recording.serial}: without a reference it says nothing of the loads; nothing was fitted: "
            f"press it under the load cell, or the source {source.serial} without"
        )
    if np.array_equal(recording.output, source.unlabelled.output):
        raise InputError(
            f"golden run of {recording.serial}: it is the source's own recording; nothing was fitted: press the source "
            "unit again in the units' sitting"
        )
    if not isinstance(run, LabelledRecording):
        # One value a sample: before the first full window of a stretch, that of the nearest one.
        read = np.interp(np.arange(len(recording)), recording.window_rows, model.network.evaluate(recording.windows))
        golden = LabelledRecording(recording, read, source.reference_unit)
        return DayCorrection(golden, SAME_DAY, 0.0, model.held_out_rmse, is_measured=False, run_sha256=run.sha256)
    day_map = _fit_day(model.network, run, method)
    corrected = replace(recording, output=day_map.gain * recording.output + day_map.offset)
    before, after = (model.network.evaluate(r.windows) for r in (recording, corrected))
    # No day explains another unit, or loads in another unit of measurement.
    load, gain, max_change = run.window_reference, day_map.gain, method.day_correction.max_gain_change
    error = rmse(after, load)
    if (
        error > method.day_correction.max_relative_error * float(np.std(load))
        or not 1 / max_change <= gain <= max_change
    ):
        unit = run.reference_unit
        compared = "; ".join(map(str, compare_recordings(source, run)))
        raise InputError(
            f"golden run of {run.serial}: with the best gain for its day, {gain:.3g}, its loads are misread by "
            f"{error:.3g} {unit} RMS; {compared or f'is it another unit, or its reference not in {unit}?'}; nothing "
            "was fitted"
        )
    golden = replace(run, unlabelled=corrected)
    return DayCorrection(golden, day_map, rmse(before, after), 0.0, is_measured=True, run_sha256=run.sha256)


def _correct_by_unit(model: SourceModel, run: LabelledRecording) -> DayCorrection:
    """Return the loads of a unit's labelled run with the output that the source would show under them at rest."""
    network, source_recording, recording = model.network, model.source.unlabelled, run.unlabelled
    levels = np.linspace(source_recording.output.min(), source_recording.output.max(), LEVELS)
    loads = network.evaluate(resting(levels))
    is_rising = model.interval.slope_limit > 0
    levels, loads = (levels, loads) if is_rising else (levels[::-1], loads[::-1])
    carried = np.interp(run.reference, np.maximum.accumulate(loads), levels)
    golden = replace(run, unlabelled=replace(recording, output=carried))
    load = golden.window_reference
    error = rmse(network.evaluate(golden.windows), load)
    is_of_it = find_synchrony(golden.unlabelled, recording, model.method.map).is_synchronous
    if not is_of_it or error > model.method.day_correction.max_relative_error * float(np.std(load)):
        raise InputError(
            f"golden run of {run.serial}: its output does not follow its reference, or f misreads these loads "
            f"({error:.3g} {run.reference_unit} RMS at the best); is the reference of this run, and in "
            f"{model.source.reference_unit}? nothing was fitted"
        )
    return DayCorrection(golden, SAME_DAY, 0.0, error, is_measured=True, run_sha256=run.sha256)


def _fit_day(network: Network, run: LabelledRecording, method: Method) -> AffineMap:
    """Fit gain and zero of a day by least squares on f; the same day where that reads held-out stretches no better."""
    rows = evenly(len(run.windows), method.map.pairs.pairs)
    # Whole stretches of time are held out: neighbouring windows share samples.
    is_held_out = np.arange(len(rows)) * 16 // len(rows) % 2 == 1
    held_out, fitted = rows[is_held_out], rows[~is_held_out]
    trial = _least_squares(network, run, fitted)
    if _load_rmse(network, run, trial, held_out) >= _load_rmse(network, run, SAME_DAY, held_out):
        return SAME_DAY
    return _least_squares(network, run, rows)


def _least_squares(network: Network, run: LabelledRecording, rows: Indices) -> AffineMap:
    windows, load = np.asarray(run.windows[rows]), run.window_reference[rows]
    centre, scale = network.output_mean, network.output_scale

    def day(theta: Array) -> AffineMap:
        gain = float(np.exp(theta[0]))
        return AffineMap(gain, centre * (1 - gain) + scale * float(theta[1]), "affine")

    solution = scipy.optimize.least_squares(
        lambda theta: network.evaluate(day(theta).apply(windows)) - load, np.zeros(2)
    )
    return day(solution.x)


def _load_rmse(network: Network, run: LabelledRecording, day_map: AffineMap, rows: Indices) -> float:
    return rmse(network.evaluate(day_map.apply(np.asarray(run.windows[rows]))), run.window_reference[rows])
