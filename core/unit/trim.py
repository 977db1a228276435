"""Trim a calibrated unit at its place of use: two or more known loads re-anchor its map. No file, no registry here.

The device trims by the same rule (docs/format.md; tests/firmware/device_stream.py).
"""

from dataclasses import replace

import numpy as np

from softcal.core.errors import InputError
from softcal.core.maps.anchors import AnchoredMap, SourceLevels, check_loads
from softcal.core.maps.interface import Anchors, FitProblem, UnitMap
from softcal.core.metrics import rms, rmse
from softcal.core.recording import OutputRecording
from softcal.core.unit.adjustments import Trim
from softcal.core.unit.uncertainty import NORMAL_90, Interval
from softcal.core.windows import resting

NOTHING = "nothing was changed"


MAX_CHANGE = 0.5
"""A gain that changes by more than this share is another unit, or other units of load. The device holds no larger one
(docs/format.md)."""


class NeedlessTrim(InputError):
    """The map reads the loads as well as a trim by them would be known."""


def trim(
    problem: FitProblem,
    unit_map: UnitMap,
    interval: Interval,
    loads: Anchors,
) -> Trim:
    """Re-anchor a fitted map by known loads at the place of use.

    Gain and offset carry what the map makes of the loads onto what the source shows under them, by a straight line
    weighted with the inverse variances. The map is not believed beside the loads: it is trimmed since it has moved.
    Not known of a load are the load itself, the error of the calibration at any reading, and what f misreads at rest.

    Args:
        unit_map: as it was fitted; a trim replaces an earlier one.
        loads: outputs at rest under known loads, at least two different ones.

    Raises:
        InputError: the loads cannot be of this unit as they stand, or leave more open than they correct; the message
            says which and why. `NeedlessTrim` where the map reads them already.
    """
    source, network, unit = problem.source, problem.network, problem.source.reference_unit
    if len(loads.reference) < 2:
        raise InputError(f"{len(loads.reference)} known load; zero and span take two different ones; {NOTHING}")
    check_loads(source, loads, NOTHING, problem.config.anchors)
    output, load = (np.asarray(values, np.float64) for values in (loads.output, loads.reference))
    source_output = SourceLevels.from_source(source, problem.config.anchors).at(load)
    read = unit_map.apply(resting(output)).mean(axis=1)
    # The standard uncertainty of what is read under each load: of the calibration, of f at rest and of the load.
    band = interval.half_width[:, interval.column(load)].max(axis=0)
    model_error = network.evaluate(resting(source_output)) - load
    load_error = problem.config.anchors.load_error * float(np.ptp(source.reference))
    error = np.hypot(np.hypot(band, model_error) / NORMAL_90, load_error)
    first, last = int(np.argmin(load)), int(np.argmax(load))
    # The source's own rise between the outermost loads: outputs in the unit of the loads.
    rise = (source_output[last] - source_output[first]) / (load[last] - load[first])
    apart = abs((read[last] - read[first]) / rise)
    open_ = NORMAL_90 * float(np.hypot(error[first], error[last]))
    if min(apart, load[last] - load[first]) <= open_:
        raise InputError(
            f"loads {first + 1} and {last + 1} cannot be told apart: outputs {output[first]:.6g} and "
            f"{output[last]:.6g} {source.unlabelled.output_unit} are {apart:.3g} {unit} apart, the loads "
            f"{load[last] - load[first]:.3g} {unit}, and each must be more than {open_:.3g} {unit}, which the readings "
            f"leave open; {NOTHING}; read loads further apart, each at rest"
        )
    # The weighted straight line that carries what is read onto what is wanted.
    gain, offset = (float(value) for value in np.polyfit(read, source_output, 1, w=1 / error))
    if abs(gain - 1) > MAX_CHANGE:
        raise InputError(
            f"the loads ask for {gain:.2g} x the gain of unit {problem.target.serial}, {1 - MAX_CHANGE:.2g} to "
            f"{1 + MAX_CHANGE:.2g} was expected; that is another unit, or other units of load or output; "
            f"{NOTHING}; check serial and columns, or calibrate it again"
        )
    missing = np.abs(source_output - read) / abs(rise)
    if np.all(missing <= error):
        raise NeedlessTrim(
            f"the map reads these loads already: it is off by {missing.max():.3g} {unit} at most, less than the "
            f"{error.max():.3g} {unit} a trim by them is known to; {NOTHING}; no trim is needed"
        )
    residuals = (offset + gain * read - source_output) / rise / error
    worst = int(np.argmax(np.abs(residuals)))
    # Twice what nine loads in ten are misread by.
    max_misfit = 2 * NORMAL_90
    if abs(residuals[worst]) > max_misfit:
        raise InputError(
            f"load {worst + 1} is still misread by {abs(residuals[worst] * error[worst]):.3g} {unit} after the trim, "
            f"{max_misfit * error[worst]:.3g} {unit} at most was expected; the loads contradict one another; "
            f"{NOTHING}; read them again"
        )
    anchored = AnchoredMap(unit_map, gain, offset)
    before, after = (rmse(network.evaluate(one.apply(resting(output))), load) for one in (unit_map, anchored))
    if after > before:
        raise InputError(
            f"the unit reads these loads worse after the trim than before: RMSE {after:.3g} and {before:.3g} {unit}; "
            f"{NOTHING}; read loads further apart, each at rest"
        )
    design = np.stack([np.ones_like(load), load], axis=1) / error[:, None]
    # Loads that do not fit a straight line know neither number better than they fit.
    spread = max(1.0, rms(residuals))
    covariance = np.asarray(np.linalg.inv(design.T @ design) * spread**2, np.float64)
    (zero, both), (_, slope) = covariance
    return Trim(
        output=tuple(map(float, output)),
        reference=tuple(map(float, load)),
        recording_sha256=problem.target.sha256,
        gain=gain,
        offset=offset,
        covariance=((float(zero), float(both)), (float(both), float(slope))),
        before_rmse=before,
        after_rmse=after,
    )


def as_trimmed(recording: OutputRecording, before: UnitMap, after: UnitMap) -> OutputRecording:
    """Return a recording as the unit would give it since the trim: mapped by `after` where `before` had mapped it.

    What is derived from a recording (ranges, clamps, self-tests of a device file) is then of the unit as it is now.
    """
    output = recording.output
    span = float(np.ptp(output))
    raw = np.unique(np.concatenate([output - span, output, output + span]))
    was, now = (one.apply(resting(raw)).mean(axis=1) for one in (before, after))
    order = np.argsort(now, kind="stable")
    return replace(recording, output=np.interp(np.interp(output, raw, was), now[order], raw[order]))
