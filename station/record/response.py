"""Response of a load cell: delay and first-order low pass, fitted to presses (ISO 4965-1). No I/O.

Slowly pressed, a low pass looks like a delay. Where the stage turns or stands it does not: a late cell shows the corner
later, a filtered one rounds it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.signal import lfilter

from softcal.core.errors import BadReply
from softcal.core.messages.reason import reason
from softcal.core.recording import Array
from softcal.station.record.method import CellLagConfig, ProofMethod, ResponseConfig

NORMAL_MEDIAN = 0.6745
"""Median of |x| of a normal distribution with a standard deviation of 1."""


@dataclass(frozen=True, eq=False)
class CellResponse:
    """Response of a load cell, estimated from one run.

    Args:
        delay_s: pure delay, positive when the force is late; NaN where the run does not tell: too shallow, too slow,
            too noisy, or presses that come again and again.
        time_constant_s: of the first-order low pass behind it, whether the delay shows or not; 0 for none.
        grid_s: (n,) host times.
        true_N, filtered_N: (n,) the force by the fitted law, and the same behind delay and low pass.
        unexplained: RMS of the changes of the force that the law leaves behind the best delay and low pass, beyond
            noise, as a share of the force's range.
    """

    delay_s: float
    time_constant_s: float
    grid_s: Array
    true_N: Array
    filtered_N: Array
    unexplained: float = 0.0

    @property
    def is_identifiable(self) -> bool:
        return bool(np.isfinite(self.delay_s))

    @property
    def lag_s(self) -> float:
        """Lag of the readings behind a slow change in s: delay plus time constant."""
        return self.delay_s + self.time_constant_s

    def error_N(self, late_s: float) -> float:
        """Return the RMS error of labels whose readings are taken as `late_s` late; 0 without a low pass."""
        if not self.time_constant_s:
            return 0.0
        inside = self.grid_s[self.grid_s + late_s < self.grid_s[-1]]
        return float(
            np.sqrt(np.mean((self._interpolate_filtered(inside + late_s) - self._interpolate_true(inside)) ** 2))
        )

    def _interpolate_filtered(self, t_s: Array) -> Array:
        return np.interp(t_s, self.grid_s, self.filtered_N)

    def _interpolate_true(self, t_s: Array) -> Array:
        return np.interp(t_s, self.grid_s, self.true_N)


def fit_response(
    t_s: Array, force_N: Array, stage_mm_at: Callable[[Array], Array], contact_mm: float, method: ProofMethod
) -> CellResponse:
    """Return delay and time constant that lay the force best over a law of the depth that relaxes.

    A solid that relaxes leads its depth, so no relaxing part of the law may be negative: only the cell can lag behind.
    All is compared behind a high pass, where softening and creep of the unit leave nothing.

    Args:
        t_s, force_N: (n,) samples of the load cell, host clock.
        stage_mm_at: host times -> stage positions, same origin as contact_mm.
    """
    law, lag, response = _Law(t_s, force_N, stage_mm_at, contact_mm, method), method.lag, method.response
    if len(t_s) < method.press.samples or not law.is_pressed:
        return CellResponse(float("nan"), 0.0, t_s, force_N, force_N)
    allowance = lag.tells_samples / len(t_s)
    delays_s = np.arange(response.earliest_s, lag.latest_s, lag.coarse_s)
    prompt = law.best(0.0, delays_s)

    def filtered(constants_s: Sequence[float]) -> "_Candidate":
        around = (-1.0, -0.7, -1.0 + lag.coarse_s / response.constants_s[0])
        return min(law.best(tau, np.array([prompt.delay_s + share * tau for share in around])) for tau in constants_s)

    best = filtered(response.constants_s)
    best = min(best, filtered([share * best.constant_s for share in response.finer]))
    if prompt.misfit < (response.tells + allowance) * best.misfit:
        best = prompt
    unexplained = law.rms_beyond_noise(best) / max(float(np.ptp(force_N)), 1e-12)
    # Presses that come again and again fit nearly as well half a press away: every other delay counts.
    others_s = [best.delay_s - lag.apart_s, best.delay_s + lag.apart_s, *delays_s]
    is_identifiable = law.best_apart(best, others_s, lag.apart_s) >= (lag.tells + allowance) * best.misfit
    delay_s = best.delay_s if is_identifiable else float("nan")
    return CellResponse(delay_s, best.constant_s, law.grid_s, *law.forces_N(best), unexplained)


def check_lag(response: CellResponse, declared_s: float, period_s: float, config: CellLagConfig) -> None:
    """Raise `BadReply` when a cell, read every `period_s`, is later or earlier than declared.

    A unit that relaxes as fast as the cell follows hides some of a low pass.
    """
    off_s, slack_s = response.lag_s - declared_s, config.late_s + config.period_share * period_s
    if off_s > slack_s or off_s < -slack_s - config.hidden * response.time_constant_s:
        lag_s = response.lag_s
        raise BadReply(reason("rig.behind", found_s=lag_s, declared_s=declared_s, latency_s=max(0.0, lag_s)))


def check_response(response: CellResponse, error_N: float, config: ResponseConfig) -> None:
    """Raise `BadReply` where a low pass leaves labels an RMS error that no source may have."""
    check_error(response.time_constant_s, error_N, config.share * float(np.ptp(response.true_N)))


def check_explained(response: CellResponse, config: ResponseConfig) -> None:
    """Raise `BadReply` where no delay and low pass explains the readings: a limit of speed, or a value that is held."""
    if response.unexplained > config.max_unexplained:
        raise BadReply(reason("rig.distorted", percent=100.0 * response.unexplained))


def check_error(constant_s: float, error_N: float, allowed_N: float) -> None:
    """Raise `BadReply` if the RMS error by a low pass is above its limit."""
    if error_N > allowed_N:
        raise BadReply(reason("rig.low_pass", constant_s=constant_s, error_N=error_N, allowed_N=allowed_N))


@dataclass(frozen=True, order=True)
class _Candidate:
    misfit: float
    delay_s: float
    constant_s: float


class _Law:
    """The columns of a law of the depth on a grid of time, and how well they make a force behind delay and low pass."""

    def __init__(
        self, t_s: Array, force_N: Array, stage_mm_at: Callable[[Array], Array], contact_mm: float, method: ProofMethod
    ) -> None:
        self._step_s, self._config, self._latest_s = method.law.grid_s, method.response, method.lag.latest_s
        self.grid_s = np.arange(t_s[0] - self._latest_s, t_s[-1] + self._step_s, self._step_s)
        depth_mm = np.maximum(0.0, stage_mm_at(self.grid_s) - contact_mm)
        self.is_pressed = bool(np.max(depth_mm) > 0.0)
        share = depth_mm / max(float(np.max(depth_mm)), 1e-9)
        self._elastic = np.column_stack([share**power for power in method.law.powers])
        relaxing = [
            lfilter([1.0, -1.0], [1.0, -np.exp(-self._step_s / time_s)], share**power)
            for time_s in method.response.relaxation_s
            for power in method.law.relaxed_powers
        ]
        self._columns = np.column_stack([self._elastic, *relaxing])
        self._even_s = max(self._step_s, float(np.median(np.diff(t_s))))
        self._at_s = np.arange(t_s[0], t_s[-1], self._even_s)
        self._force_N = np.interp(self._at_s, t_s, force_N)
        # What arrives first may belong to a path before these samples, which the law does not know.
        self._first = min(round(self._latest_s / self._even_s), len(self._at_s) // 2)
        self._decay = float(np.exp(-self._even_s / self._config.high_pass_s))
        self._fading = self._decay ** np.arange(len(self._at_s) - self._first)
        self._passed_N = self._passed(self._force_N)

    def rms_beyond_noise(self, fit: _Candidate) -> float:
        """Return the RMS of what a fit leaves, in N, but for noise: for what changes from sample to sample and back."""
        bends_N = np.diff(self._force_N, 2)
        variance = (float(np.median(np.abs(bends_N))) / NORMAL_MEDIAN) ** 2 / 6.0 if len(bends_N) else 0.0
        # Behind the high pass white noise has this part more.
        mean_square = fit.misfit / len(self._passed_N) - 2.0 * variance / (1.0 + self._decay)
        return float(np.sqrt(max(0.0, mean_square)))

    def best(self, constant_s: float, delays_s: Array) -> _Candidate:
        """Return the best of these delays, refined around the minimum."""
        columns = low_pass(self._columns, constant_s, self._step_s)
        allowed_s = np.unique(np.maximum(delays_s, self._config.earliest_s))
        coarse = min(self._candidate(columns, constant_s, delay_s) for delay_s in allowed_s.tolist())
        around_s = [coarse.delay_s + off_s for off_s in self._config.fine_s]
        near = [self._candidate(columns, constant_s, s) for s in around_s if s >= self._config.earliest_s]
        return min([coarse, *near])

    def best_apart(self, fit: _Candidate, delays_s: Sequence[float], apart_s: float) -> float:
        """Return the least misfit of delays at a given distance from the fitted delay."""
        columns = low_pass(self._columns, fit.constant_s, self._step_s)
        others_s = [delay_s for delay_s in delays_s if abs(delay_s - fit.delay_s) > 0.99 * apart_s]
        return min(self._candidate(columns, fit.constant_s, delay_s).misfit for delay_s in others_s)

    def forces_N(self, fit: _Candidate) -> tuple[Array, Array]:
        """Return the force on the grid, and the force after the response of the cell."""
        filtered = low_pass(self._columns, fit.constant_s, self._step_s)
        weights, _ = self._weights(filtered, fit.delay_s)
        level_N = float(np.mean(self._force_N - columns_at(self._at_s - fit.delay_s, self.grid_s, filtered) @ weights))
        late = np.interp(self.grid_s - fit.delay_s, self.grid_s, filtered @ weights)
        return level_N + self._columns @ weights, level_N + late

    def _candidate(self, columns: Array, constant_s: float, delay_s: float) -> _Candidate:
        return _Candidate(self._weights(columns, delay_s)[1], delay_s, constant_s)

    def _weights(self, columns: Array, delay_s: float) -> tuple[Array, float]:
        count = 1 + self._elastic.shape[1]
        late = self._passed(columns_at(self._at_s - delay_s, self.grid_s, columns))
        r: Array = np.asarray(np.linalg.qr(np.column_stack([self._fading, late, self._passed_N]), mode="r"))
        relaxing, residual = nnls(r[count:, count:-1], r[count:, -1])
        free = np.linalg.lstsq(r[:count, :count], r[:count, -1] - r[:count, count:-1] @ relaxing, rcond=None)[0]
        return np.concatenate([free[1:], relaxing]), residual**2

    def _passed(self, columns: Array) -> Array:
        """Return columns behind the high pass, after what fades of where that begins."""
        return np.asarray(lfilter([1.0, -1.0], [1.0, -self._decay], columns[self._first :], axis=0))


def columns_at(at_s: Array, grid_s: Array, columns: Array) -> Array:
    """Return `np.interp` of each column, (n, m) over the grid; where an instant lies is looked up once for all."""
    before = np.clip(np.searchsorted(grid_s, at_s, "right") - 1, 0, len(grid_s) - 2)
    left_s, left = grid_s[before], columns[before]
    slope = (columns[before + 1] - left) / (grid_s[before + 1] - left_s)[:, None]
    values = slope * (at_s - left_s)[:, None] + left
    values[at_s < grid_s[0]], values[at_s >= grid_s[-1]] = columns[0], columns[-1]
    return np.asarray(values)


def low_pass(columns: Array, constant_s: float, step_s: float) -> Array:
    """Return columns, (n, m), behind a first-order low pass, straight between their samples and at rest before them."""
    if not constant_s:
        return columns
    decay = float(np.exp(-step_s / constant_s))
    newest = 1.0 - constant_s / step_s * (1.0 - decay)
    at_rest = (1.0 - newest) * columns[:1]
    return np.asarray(lfilter([newest, 1.0 - decay - newest], [1.0, -decay], columns, axis=0, zi=at_rest)[0])
