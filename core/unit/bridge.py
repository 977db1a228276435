"""The source unit pressed again in the sitting of the units: what carries their day and programme to the source's.

A unit and the golden unit that met one load at one time differ by what the units differ by, and by nothing that the day
or the programme does to both. The map of the unit is therefore fitted to the golden run in place of the source's
recording. What the day does to the golden unit itself is a gain and a zero, fitted where a load cell was under it.
"""

from dataclasses import dataclass, replace

import numpy as np

from softcal.core.errors import InputError
from softcal.core.inspection.comparison import compare_recordings
from softcal.core.maps.affine_map import AffineMap
from softcal.core.metrics import rmse
from softcal.core.network.network import Network
from softcal.core.recording import Array, Indices, LabelledRecording, OutputRecording
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import SourceModel
from softcal.core.windows import evenly

SAME_DAY = AffineMap(1.0, 0.0, "identity")


@dataclass(frozen=True, eq=False)
class Bridge:
    """A golden run as units of its sitting are compared with it.

    Args:
        golden: the source unit's run, its output carried to the source's day, with its reference: measured, or what f
            reads where no load cell was under it.
        day_map: gain and zero of that day's output on the source's.
        day_rmse: RMS change of the estimates that the day makes, in the reference unit; 0 where it was not measured.
        floor: RMS error of `golden`'s reference, in the same.
    """

    golden: LabelledRecording
    day_map: AffineMap
    day_rmse: float
    floor: float
    is_measured: bool

    @property
    def sha256(self) -> str:
        """Content hash of what units are compared with."""
        return self.golden.sha256


def make_bridge(model: SourceModel, run: OutputRecording | LabelledRecording) -> Bridge:
    """Look at a golden run through f.

    Args:
        run: the source unit pressed in the units' sitting, with a reference where a load cell was under it.

    Raises:
        InputError: it is of another unit, is the source's own recording, or f cannot read it.
    """
    recording = run.unlabelled if isinstance(run, LabelledRecording) else run
    source, method = model.source, model.method
    if recording.serial != source.serial:
        raise InputError(
            f"golden run of {recording.serial}: the golden unit of this lot is its source {source.serial}; nothing was "
            "fitted: press the source unit in the units' sitting"
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
        return Bridge(golden, SAME_DAY, 0.0, model.held_out_rmse, is_measured=False)
    day_map = _fit_day(model.network, run, method)
    corrected = replace(recording, output=day_map.gain * recording.output + day_map.offset)
    before, after = (model.network.evaluate(r.windows) for r in (recording, corrected))
    # No day explains another unit, or loads in another unit of measurement.
    load, gain, most = run.window_reference, day_map.gain, method.bridge.most_gain
    error = rmse(after, load)
    if error > method.bridge.most_misread * float(np.std(load)) or not 1 / most <= gain <= most:
        unit = run.reference_unit
        compared = "; ".join(map(str, compare_recordings(source, run)))
        raise InputError(
            f"golden run of {run.serial}: with the best gain for its day, {gain:.3g}, its loads are misread by "
            f"{error:.3g} {unit} RMS; {compared or f'is it another unit, or its reference not in {unit}?'}; nothing "
            "was fitted"
        )
    return Bridge(replace(run, unlabelled=corrected), day_map, rmse(before, after), 0.0, is_measured=True)


def _fit_day(network: Network, run: LabelledRecording, method: Method) -> AffineMap:
    """Fit gain and zero of a day by least squares on f; the same day where that reads held-out stretches no better."""
    rows = evenly(len(run.windows), method.map.pairs.pairs)
    # Whole stretches of time are held out: neighbouring windows share samples.
    is_held = np.arange(len(rows)) * 16 // len(rows) % 2 == 1
    held, fitted = rows[is_held], rows[~is_held]
    trial = _least_squares(network, run, fitted)
    if _misread(network, run, trial, held) >= _misread(network, run, SAME_DAY, held):
        return SAME_DAY
    return _least_squares(network, run, rows)


def _least_squares(network: Network, run: LabelledRecording, rows: Indices) -> AffineMap:
    from scipy.optimize import least_squares

    windows, load = np.asarray(run.windows[rows]), run.window_reference[rows]
    centre, scale = network.output_mean, network.output_scale

    def day(theta: Array) -> AffineMap:
        gain = float(np.exp(theta[0]))
        return AffineMap(gain, centre * (1 - gain) + scale * float(theta[1]), "affine")

    solution = least_squares(lambda theta: network.evaluate(day(theta).apply(windows)) - load, np.zeros(2))
    return day(solution.x)


def _misread(network: Network, run: LabelledRecording, day_map: AffineMap, rows: Indices) -> float:
    return rmse(network.evaluate(day_map.apply(np.asarray(run.windows[rows]))), run.window_reference[rows])
