"""What one unit's calibration says about its errors: how far an estimate moves when its output drifts."""

import numpy as np

from softcal.core.metrics import rms
from softcal.core.network.network import Network
from softcal.core.recording import Array, OutputRecording
from softcal.core.unit.calibration import Calibration
from softcal.core.unit.uncertainty import NORMAL_90
from softcal.core.use.activity import CalibratedUse, RestCurve, learn_use
from softcal.core.use.method import UseMethod
from softcal.core.windows import resting


def learn_sensitivity(
    network: Network, calibration: Calibration, recording: OutputRecording, method: UseMethod
) -> tuple[CalibratedUse, float]:
    """Return the calibrated use, and by how much an estimate moves (RMS) when the output moves by one scale of it."""
    config = method.doubt
    windows = recording.windows[:: max(1, len(recording) // config.slope_rows)]

    def estimates(moved: Array) -> Array:
        return network.evaluate(calibration.unit_map.apply(moved))

    estimated = estimates(windows)
    is_rising = np.cov(windows[:, -1], estimated)[0, 1] >= 0
    low, high = np.quantile(recording.output, method.cycle.swing)
    # Constant outputs up to a swing beyond the recording.
    levels = np.linspace(2 * low - high, 2 * high - low, config.zero_levels)
    curve = RestCurve(levels, estimates(resting(levels)))
    zero_output = _zero_load_output(curve, low, high)
    if (shown := _shown_zero(windows[:, -1], estimated, method)) is not None:
        zero_output, at_zero = shown, float(np.interp(shown, levels, curve.load))
        curve = RestCurve(levels, curve.load - at_zero)
    use = learn_use(recording, bool(is_rising), zero_output, method, curve if zero_output is not None else None)
    # A difference over a finite step, not the derivative: f is piecewise linear with kinks close together.
    step = config.slope_step * use.scale
    rise = (estimates(windows + step) - estimates(windows - step)) / (2 * config.slope_step)
    return use, rms(rise)


def _zero_load_output(curve: RestCurve, low: float, high: float) -> float | None:
    """Return the constant output that is estimated as zero; None without one."""
    levels, values = curve.output, curve.load
    crossings = np.flatnonzero(values[:-1] * values[1:] <= 0)
    if not len(crossings):
        return None
    # f may cross zero more than once outside what it was trained on: the crossing next to the unloaded end counts.
    unloaded = low if values[-1] > values[0] else high
    return float(levels[crossings[np.argmin(np.abs(levels[crossings] - unloaded))]])


def _shown_zero(output: Array, estimates: Array, method: UseMethod) -> float | None:
    """Return the output of a recording where it comes to zero load; None where it does not.

    A use that turns without a rest comes there only in motion, which f knows and a constant output does not show.
    """
    least = np.abs(estimates) <= np.quantile(np.abs(estimates), 1 - method.cycle.swing[1])
    is_near = np.median(np.abs(estimates[least])) <= method.trust.preload * np.std(estimates)
    return float(np.median(output[least])) if is_near else None


def calibrated_rmse(calibration: Calibration) -> float:
    """Return the error a calibration promises, in the reference unit."""
    if calibration.predicted_rmse is not None:
        return calibration.predicted_rmse
    return rms(calibration.interval.half_width) / NORMAL_90
