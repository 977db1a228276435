"""The load that units share: its weighted mean over time, and every map paired with that of the others."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from softcal.core.maps.affine_map import TWO_POINT
from softcal.core.maps.anchors import source_curvature
from softcal.core.maps.choose import ChosenMap, choose_map
from softcal.core.maps.config import MapConfig, SharedLoadConfig
from softcal.core.maps.crossing import swings
from softcal.core.maps.interface import FitProblem, UnitMap
from softcal.core.maps.monotone import AVERAGED, MONOTONE, weigh_line
from softcal.core.maps.paired import SHARED_LOAD, STAGE_MATCHED, SYNCHRONOUS, fit_pairs
from softcal.core.maps.synchrony import NONE, Synchrony, find_synchrony, paired_rows
from softcal.core.messages.reason import Reason, reason
from softcal.core.metrics import rms
from softcal.core.recording import Array, Indices, LabelledRecording, OutputRecording
from softcal.core.windows import TAPS, evenly

SPREAD = "lot_fit.spread"
"""Code of the reason why units whose presses differ keep their own maps."""


@dataclass(frozen=True, eq=False)
class LotUnit:
    """The part that one unit has in the fit of its lot.

    Args:
        alone: its map as it is fitted without the lot.
        unit_map: its map; that of `alone` where the unit stands alone.
        group: place of its group in `LotFit.groups`; None where it stands alone.
        weight: in the common load of its group, as a share.
        moved_rmse: RMS by which its estimates differ from the common load of the others before it was paired with that,
            in the reference unit: its own map's error, as the others see it.
        unit_rmse: standard uncertainty of the unit's own part: the same after, and by how much it is bent otherwise
            than the others. Outputs do not tell a bend, which pairing takes out, from a press of another depth, which
            it does not see.
        reason: why it stands alone; None for a member.
    """

    alone: ChosenMap
    unit_map: UnitMap
    group: int | None = None
    weight: float = 0.0
    moved_rmse: float = 0.0
    unit_rmse: float = 0.0
    reason: Reason | None = None

    @property
    def press_spread(self) -> float:
        """By how much of the load its presses differ from those of the others; 0 where that keeps no map alone."""
        is_spread = self.reason is not None and self.reason.code == SPREAD
        return float(str(self.reason.values["share"])) if self.reason is not None and is_spread else 0.0


@dataclass(frozen=True, eq=False)
class LoadGroup:
    """Units that were pressed by one load at once.

    Args:
        members: serials of the units under the load, in the order of the lot; none where the load that they seem to
            share differs from unit to unit.
        t_s: (n,) time stamps on the clock of its first member.
        load: (n,) common load in the reference unit.
        shape_rmse: standard uncertainty of the course of the common load: by how the members differ from each other, as
            the source then does from them, and by what lines and curves differ beyond that.
        gain_rmse: that of its gain: members that miss the hardest presses of the source miss them together. A load by
            curves of equal quantiles has none: they know no hardest press.
    """

    members: tuple[str, ...]
    t_s: Array
    load: Array
    shape_rmse: float
    gain_rmse: float

    @property
    def common_rmse(self) -> float:
        """Standard uncertainty of the common load.

        What f misreads alike of all members is no part of it: other sources, an audit or a golden run of their sitting
        show that.
        """
        return float(np.hypot(self.shape_rmse, self.gain_rmse))


class LotMember:
    """A unit with its own map, and what it has in common with the first of its group."""

    def __init__(self, problem: FitProblem) -> None:
        self.problem, self.serial = problem, problem.target.serial
        self.alone = choose_map(problem)
        self.synchrony: Synchrony = NONE
        self.line_share = 0.5

    @property
    def exclusion_reason(self) -> Reason | None:
        """Why its load needs no other unit; None where it does."""
        has_load = self.alone.family in (SYNCHRONOUS, STAGE_MATCHED) or self.problem.anchors is not None
        return reason("lot_fit.known") if has_load else None

    def at(self, first: OutputRecording) -> tuple[Indices, Indices]:
        """Return rows of windows of the group's first unit, and of this one, under one load."""
        return paired_rows(first, self.problem.target, self.synchrony)

    def mapped(self, rows: Indices) -> tuple[Array, Array]:
        """Return estimate and newest mapped sample of some windows by its own map."""
        windows, share = self.problem.target.windows[rows], self.line_share
        if self.is_undecided:
            line, curve = (self.alone.alternatives[name].apply(windows) for name in (TWO_POINT, MONOTONE))
            windows = share * line + (1.0 - share) * curve
        else:
            windows = self.alone.unit_map.apply(windows)
        return self.problem.network.evaluate(windows), windows[:, -1]

    @property
    def is_undecided(self) -> bool:
        """Whether nothing in its own output tells a bend from a dwell (`fit_averaged`)."""
        return self.alone.family == AVERAGED


def find_groups(
    targets: Sequence[OutputRecording], config: MapConfig
) -> Iterator[list[tuple[OutputRecording, Synchrony]]]:
    """Give units that share a load, each with how its clock stands to the first of them.

    Each unit is compared with the first of a few groups, so that the cost is linear.
    """
    remaining, rules = list(targets), config.shared_load
    for _ in range(rules.max_groups):
        if len(remaining) < rules.min_members:
            return
        first, others, remaining = remaining[0], remaining[1:], []
        group = [(first, Synchrony(0.0, 1.0, 1.0, np.inf, is_synchronous=True))]
        for one in others:
            synchrony = find_synchrony(first, one, config)
            if synchrony.is_synchronous:
                group.append((one, synchrony))
            else:
                remaining.append(one)
        if len(group) >= rules.min_members:
            yield group


class SharedLoad:
    """Units under one load: their common load, their maps paired with it, and those it leaves out."""

    def __init__(self, members: Sequence[LotMember], config: SharedLoadConfig, paired: Collection[str]) -> None:
        self._config, self._first = config, members[0].problem.target
        count = len(self._first.windows)
        self._thin = evenly(count, config.instants)
        self.excluded: dict[str, Reason] = {}
        self._members = self._calm(members)
        self._weights = self._decide_line()
        # Sums over the units: weight, estimates, mapped samples.
        self._total = np.zeros((3, count))
        for one, weight in zip(self._members, self._weights, strict=True):
            rows, values = self._share(one, weight)
            self._total[:, rows] += values
        self._pair(paired)

    def _calm(self, members: Sequence[LotMember]) -> list[LotMember]:
        """Leave out members that swing far more often than the others under one load: what they show is no press."""
        maps = members[0].problem.config
        rates = [swings(one.problem.target, maps.crossing) / len(one.problem.target) for one in members]
        usual = float(np.median(rates))
        for one, rate in zip(members, rates, strict=True):
            if rate > maps.choice.unlike_rate * usual > 0:
                self.excluded[one.serial] = reason("lot_fit.noisy", times=rate / usual)
        return [one for one in members if one.serial not in self.excluded]

    def _share(self, one: LotMember, weight: float) -> tuple[Indices, Array]:
        """Return the rows a unit adds to, and what it adds: weight, weighted estimates, weighted mapped samples."""
        rows, target_rows = one.at(self._first)
        return rows, weight * np.stack([np.ones(len(rows)), *one.mapped(target_rows)])

    def _decide_line(self) -> Array:
        """Settle how far the lines through rest and peak are believed beside the curves of equal quantiles.

        Returns:
            (units,) weights in the common load.
        """
        undecided, names = [one for one in self._members if one.is_undecided], [one.serial for one in self._members]
        loads = []
        for share in (0.0, 1.0):
            for one in undecided:
                one.line_share = share
            estimates = self._estimates()
            weights = self._weighed(estimates)
            loads.append(_mean(estimates, weights))
        # A unit that is bent otherwise than the others by its line may as well have been pressed otherwise.
        self._bent = dict(zip(names, np.sqrt(_mean_square(estimates - loads[1])).tolist(), strict=True))
        if not undecided:
            self._shape_rmse = float(np.sqrt(weights**2 @ _mean_square(estimates - loads[1])))
            self._gain_rmse = 0.0
            return weights
        first = self._members[0].problem
        span = float(np.ptp(np.quantile(first.source.reference, first.config.curve.shares)))
        spread, apart = (float(np.nanmean(of**2)) / span**2 for of in (estimates - loads[1], loads[1] - loads[0]))
        curvature = source_curvature(first.source, first.config)
        # Units that miss the hardest presses of the source miss them together: that error is one for all.
        gain_error = float(np.median([float(one.alone.evidence["gain_error"]) for one in undecided]))
        low = first.config.crossing.robust_range[0]
        gain = gain_error * rms(loads[1] - np.quantile(loads[1], low)) / span
        share, shape_error = weigh_lines(spread, curvature, apart, gain, len(self._members), first.config)
        for one in undecided:
            one.line_share = share
        self._gain_rmse, self._shape_rmse = span * share * gain, span * shape_error
        return self._weighed(self._estimates())

    def _estimates(self) -> Array:
        """Return the estimates of every unit by its own map at some instants: (units, instants), NaN where none is."""
        estimates = np.full((len(self._members), len(self._thin)), np.nan)
        for k, one in enumerate(self._members):
            rows, target_rows = one.at(self._first)
            position = np.minimum(np.searchsorted(rows, self._thin), len(rows) - 1)
            is_covered = rows[position] == self._thin
            estimates[k, is_covered] = one.mapped(target_rows[position[is_covered]])[0]
        return estimates

    def _weighed(self, estimates: Array) -> Array:
        """Return the weights of the units in the common load, from how far each is from the others'.

        w_i = 1 / (s^2 + d_i^2), with d_i the distance and s its median: the weights of a Student t location estimate
        (Lange, Little and Taylor 1989). A unit that errs much counts little.
        """
        is_covered = np.isfinite(estimates)
        weights, filled = np.ones(len(estimates)), np.where(is_covered, estimates, 0.0)
        for _ in range(20):
            total, sums = weights @ is_covered, weights @ filled
            # A unit is held against the others alone: with few units it would else be its own witness.
            others = (total - weights[:, None] * is_covered), (sums - weights[:, None] * filled)
            distance = np.where(
                is_covered & (others[0] > 0), filled - others[1] / np.maximum(others[0], 1e-300), np.nan
            )
            apart = np.sqrt(_mean_square(distance))
            fresh = 1.0 / (np.median(apart) ** 2 + apart**2 + 1e-300)
            fresh *= len(estimates) / fresh.sum()
            weights, change = fresh, np.max(np.abs(fresh - weights))
            # A hundredth of the mean weight moves no estimate.
            if change < 0.01:
                break
        return np.asarray(weights / weights.sum())

    def _others(self, one: LotMember, weight: float) -> LabelledRecording:
        """Return the common load of the other units: their mean mapped samples, and their mean estimates beside."""
        rows, own_share = self._share(one, weight)
        total = self._total.copy()
        total[:, rows] -= own_share
        (t_s, load, mapped), source = self._means(total), one.problem.source
        output = OutputRecording("common", t_s, mapped, self._first.sample_rate_Hz, source.unlabelled.output_unit)
        return LabelledRecording(output, load, source.reference_unit)

    def _means(self, total: Array) -> tuple[Array, Array, Array]:
        """Return time stamps, mean estimates and mean mapped samples where units of enough weight cover them."""
        covered = np.flatnonzero(total[0] > self._config.min_share)
        load, mapped = total[1:, covered] / total[0, covered]
        return self._first.t_s[self._first.window_rows[covered]], load, mapped

    def _pair(self, paired: Collection[str]) -> None:
        self._maps, self._apart, bins = {}, {}, []
        for one, weight in zip(self._members, self._weights, strict=True):
            if one.serial not in paired:
                continue
            common = self._others(one, weight)
            problem = FitProblem(common, one.problem.network, one.problem.target, config=one.problem.config)
            common_rows, target_rows = paired_rows(common.unlabelled, problem.target, one.synchrony)
            if len(target_rows) < one.problem.config.pairs.blocks * TAPS:
                self.excluded[one.serial] = reason("lot_fit.alone")
                continue
            unit_map = fit_pairs(problem, common_rows, target_rows, SHARED_LOAD)
            rows = evenly(len(target_rows), self._config.instants)
            load = common.window_reference[common_rows[rows]]
            windows = problem.target.windows[target_rows[rows]]
            before, after = (
                problem.network.evaluate(each.apply(windows)) - load for each in (one.alone.unit_map, unit_map)
            )
            self._maps[one.serial] = unit_map
            self._apart[one.serial] = rms(before), rms(after)
            bins.append(_by_load(load, after))
        usual = float(np.median([rest for _, rest in self._apart.values()] or [0.0]))
        for serial, (_, rest) in self._apart.items():
            if rest > self._config.outlying * usual:
                self.excluded[serial] = reason("lot_fit.outlier", rmse=rest, usual=usual, unit=self._unit)
        self.growth = _growth(np.median(np.stack(bins), axis=0)) if bins else 0.0

    @property
    def _unit(self) -> str:
        return self._members[0].problem.source.reference_unit

    @property
    def _inside(self) -> list[str]:
        return [one.serial for one in self._members if one.serial not in self.excluded]

    @cached_property
    def reason(self) -> Reason | None:
        """Why the maps are not paired with the common load; None where they are."""
        inside, cause = self._inside, None
        if self.growth > self._config.max_growth:
            cause = reason(SPREAD, share=self.growth)
        elif len(inside) < self._config.min_members:
            cause = reason("lot_fit.few", count=len(inside))
        if cause is not None:
            self.excluded |= {serial: cause for serial in inside}
        return cause

    def fitted(self, group: int) -> dict[str, LotUnit]:
        """Return the units whose maps are paired with the common load."""
        by_serial = {one.serial: (one, float(w)) for one, w in zip(self._members, self._weights, strict=True)}
        return {
            serial: LotUnit(by_serial[serial][0].alone, unit_map, group, by_serial[serial][1], *self._parts(serial))
            for serial, unit_map in self._maps.items()
            if serial not in self.excluded
        }

    def _parts(self, serial: str) -> tuple[float, float]:
        before, after = self._apart[serial]
        return before, float(np.hypot(after, self._bent[serial]))

    @property
    def summary(self) -> LoadGroup:
        """What the group has in common."""
        t_s, load, _ = self._means(self._total)
        return LoadGroup(tuple(self._inside), t_s, load, self._shape_rmse, self._gain_rmse)


def weigh_lines(
    spread: float, curvature: float, apart: float, gain: float, units: int, config: MapConfig
) -> tuple[float, float]:
    """Return how far lines through rest and peak are believed beside curves of equal quantiles, and what is left.

    A line errs where the units are bent otherwise than the source, or where they were pressed less hard; a curve where
    their time is spent otherwise: all alike for all units. The variances V_l and V_c of these two errors give the
    weights (`weigh_line`). Over a lot nothing ties one error to the other: what the recording of a single unit gives to
    both is averaged out.

    V_l: the source's bend b is measured, that of a unit is drawn about the mean of its kind with the variance s^2 of
    the lines over the units. With a normal prior of that mean, of standard deviation M about a straight line, the error
    has mean r b and variance r M^2 + s^2 / n, where r = s^2 / (s^2 + M^2). The uncertainty of the gain comes on top.
    V_c: of the mean square D^2 between the common loads by lines and by curves it is what V_l leaves. It counts as one
    observation, and its prior as another.

    Args:
        spread: s^2, as all else as a share of the source's range.
        curvature: b.
        apart: D^2.
        gain: standard uncertainty of what the hardest presses of the units fall short of the source's.
        units: n.

    Returns:
        The share of the lines, and the standard uncertainty of the common load by both, without that of its gain.
    """
    shared = config.shared_load
    individual = spread / (spread + shared.mean_curvature**2)
    of_lines = (individual * curvature) ** 2 + individual * shared.mean_curvature**2 + spread / units + gain**2
    of_curves = 0.5 * (max(apart - of_lines, 0.0) + shared.dwell**2)
    share, error = weigh_line(of_lines**0.5, of_curves**0.5, correlation=0.0)
    return share, float(np.sqrt(max(error**2 - (share * gain) ** 2, 0.0)))


def _mean_square(apart: Array) -> Array:
    return np.asarray(np.nanmean(apart**2, axis=1))


def _mean(estimates: Array, weights: Array) -> Array:
    is_covered = np.isfinite(estimates)
    return np.asarray(weights @ np.where(is_covered, estimates, 0.0) / np.maximum(weights @ is_covered, 1e-300))


def _by_load(load: Array, apart: Array) -> Array:
    """Return mean load above rest and mean square difference in eight bands of equally many rows: (2, 8)."""
    order = np.array_split(np.argsort(load, kind="stable"), 8)
    lowest = float(np.mean(load[order[0]]))
    return np.array([[np.mean(load[rows]) - lowest for rows in order], [np.mean(apart[rows] ** 2) for rows in order]])


def _growth(bands: Array) -> float:
    """Return b of the mean square difference a^2 + b^2 load^2: the part of it that grows with the load."""
    load, square = bands
    design = np.stack([np.ones_like(load), load**2], axis=1)
    return float(np.sqrt(scipy.optimize.nnls(design, square)[0][1]))
