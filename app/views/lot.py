"""A lot at a glance: yields, errors and the process."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np
from scipy.stats import fisher_exact

from softcal.app.registry.limit import limit_or_none
from softcal.app.views.lot_runs import LotFilter, YieldAt, lot_runs, yield_over
from softcal.core.errors import InputError
from softcal.core.lot import Lot
from softcal.core.messages.reason import Reason
from softcal.core.quality.control_chart import FORBIDDING, Capability, ControlChart, capability, control_chart
from softcal.core.quality.yields import UNDECIDED, UnitRun, Yields, yields
from softcal.core.recording import Array
from softcal.core.unit.verdict import VERDICTS, Limit
from softcal.db.entries import RunEntry, UnitEntry
from softcal.db.registry import Registry

NEWEST_OF_YIELD = 20
"""So many of the newest units are compared with all before them; set, not fitted."""

DROP_CHANCE = 0.005
"""A drop that chance shows more often is none; set, not fitted: looked at after every unit."""

EVERY_RUN = LotFilter()
ACCEPTED = ("pass", "conditional")
NEEDS_A_LOOK = ("fail", "retest", "conditional")


@dataclass(frozen=True)
class RuleBroken:
    """One rule of the chart (Nelson 1984) that is broken `count` times, the newest of them at `last`.

    Points that follow one another break it once. It may forbid to state a capability.

    Args:
        starts: (count,) indices of the first points.
    """

    rule: int
    count: int
    last: str
    forbids: bool
    starts: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class ProcessView:
    """The predicted errors of accepted units in the order they were calibrated.

    An error is above zero and its spread grows with it: the chart is of log10 of the errors in the reference unit, so
    that its limits are errors that a unit can have. A unit that failed is no part of the process that is charted.

    Args:
        serials: (n,) one per value of the chart.
        broken: rules that points break, the forbidding ones first.
        capability: of log10 of the errors of all units against that of the lot's limit.
        refusal: why there is no chart or no capability.
    """

    serials: tuple[str, ...]
    chart: ControlChart | None
    broken: tuple[RuleBroken, ...]
    capability: Capability | None
    refusal: Reason | None

    @property
    def errors(self) -> Array:
        """(n,) errors of the chart in the reference unit; empty without one."""
        return np.zeros(0) if self.chart is None else 10**self.chart.values

    @property
    def levels(self) -> tuple[float, ...]:
        """Lower limit, centre and upper limit of the errors in the reference unit; empty without a chart."""
        return (
            () if self.chart is None else tuple(10**x for x in (self.chart.lower, self.chart.centre, self.chart.upper))
        )


@dataclass(frozen=True)
class YieldDrop:
    """The newest `count` units pass less often in their first run, beyond chance."""

    newest: float
    before: float
    count: int


@dataclass(frozen=True, eq=False)
class LotView:
    """A lot at a glance.

    Args:
        counts: target units by verdict; `none` has no result yet.
        errors: of the units with a map.
        reasons: one of each kind with how many units have it, the most frequent first.
        process: the errors in time order.
        days, stations, operators: first-pass yield over each of them.
        chosen: serials that a filter leaves; None without a filter.
        limit: stated or derived; None where none is stated and no unit is calibrated yet.
        withdrawn: units that were released once and are no more, whatever a filter leaves.
        after_to_own: median of after / own over audited units, on the rows that own was tested on; None without any.
    """

    lot: Lot
    counts: Mapping[str, int]
    errors: tuple[UnitEntry, ...]
    yields: Yields
    reasons: tuple[tuple[Reason, int], ...]
    process: ProcessView
    drop: YieldDrop | None = None
    days: tuple[YieldAt, ...] = ()
    stations: tuple[YieldAt, ...] = ()
    operators: tuple[YieldAt, ...] = ()
    chosen: tuple[str, ...] | None = None
    every_station: tuple[str, ...] = ()
    every_operator: tuple[str, ...] = ()
    limit: Limit | None = None
    withdrawn: tuple[str, ...] = ()
    after_to_own: float | None = None

    @property
    def limit_rmse(self) -> float | None:
        """The stated limit in the reference unit; None where nobody stated one."""
        return None if self.limit is None else self.limit.stated_rmse

    @property
    def total(self) -> int:
        """Target units registered."""
        return sum(self.counts.values())

    @property
    def decided(self) -> int:
        """Target units with a result."""
        return self.total - self.counts["none"]

    def predicted(self, verdict: str | None = None) -> Array:
        """Return the predicted errors in the reference unit, of all units or of one verdict."""
        rows = (row for row in self.errors if verdict is None or row.verdict == verdict)
        return np.array([row.predicted_rmse for row in rows if row.predicted_rmse is not None], dtype=float)

    @property
    def median_predicted(self) -> float | None:
        """Median predicted error; None while no unit has one."""
        values = self.predicted()
        return float(np.median(values)) if len(values) else None

    @property
    def audited(self) -> tuple[UnitEntry, ...]:
        """Units with a score against a reference."""
        return tuple(row for row in self.errors if row.after_rmse is not None)


def lot_view(registry: Registry, lot_id: str, lot_filter: LotFilter = EVERY_RUN) -> LotView:
    """Read a lot at a glance, or what a filter leaves of it."""
    lot, every = registry.lots.get(lot_id), lot_runs(registry, lot_id)
    attributed_runs = [run for run in every if lot_filter.takes(run)]
    runs = [one.run for one in attributed_runs]
    chosen = None if lot_filter.is_open else tuple(sorted({run.serial for run in runs}))
    golden = {run.serial for run in registry.stations.golden_runs(lot_id=lot_id)}
    by_unit: dict[str, list[UnitRun]] = {}
    for run in runs:
        by_unit.setdefault(run.serial, []).append(UnitRun(run.verdict, run.reasons))
    shares = yields(by_unit, golden)
    errors, limit = registry.pages.lot_errors(lot_id), limit_or_none(registry, lot_id)
    if chosen is not None:
        serials = frozenset(chosen)
        errors = [row for row in errors if row.serial in serials]
    counts = registry.pages.verdict_counts(lot_id)
    # As `LotStanding.withdrawn`; unit by unit only where more passed once than now.
    passed, withdrawn = registry.calibrations.passed_once(lot_id), []
    if len(passed) != counts["pass"]:
        unit_statuses = registry.pages.unit_statuses(lot_id, sorted(passed))
        withdrawn = sorted(serial for serial, one in unit_statuses.items() if one.verdict != "pass")
    if chosen is not None:
        # By the verdict of the map in use, without one by the newest run.
        verdicts = {run.serial: run.verdict for run in runs} | {row.serial: row.verdict for row in errors}
        of_chosen = Counter(verdicts.values())
        counts = {word: of_chosen[word] for word in (*reversed(VERDICTS), "none")}
    with_own = [row.serial for row in errors if row.own_rmse is not None]
    of_units = [one for one in attributed_runs if one.run.serial not in golden]
    return LotView(
        lot,
        counts,
        tuple(errors),
        shares,
        shares.reasons,
        process_view(runs, None if limit is None else limit.stated_rmse),
        yield_drop(runs),
        yield_over(of_units, lambda run: run.day(lot_filter.zone).isoformat()),
        yield_over(of_units, lambda run: run.station),
        yield_over(of_units, lambda run: run.operator),
        chosen,
        tuple(sorted({run.station for run in every})),
        tuple(sorted({run.operator for run in every})),
        limit,
        tuple(withdrawn),
        _after_to_own(registry, lot_id, with_own),
    )


def _after_to_own(registry: Registry, lot_id: str, serials: Sequence[str]) -> float | None:
    summaries = [one.calibration for one in registry.pages.unit_statuses(lot_id, serials).values()] if serials else []
    scores = [one.state.scores for one in summaries if one is not None]
    ratios = [one.own.after_ratio for one in scores if one is not None and one.own is not None]
    return median(ratios) if ratios else None


def yield_drop(runs: Sequence[RunEntry]) -> YieldDrop | None:
    """Return a drop of the first-pass yield over the newest units; None where chance explains it.

    Fisher's exact test, one-sided (Fisher 1922), over runs in time order.
    """
    first: dict[str, bool] = {}
    for run in runs:
        if run.verdict not in UNDECIDED:
            first.setdefault(run.serial, run.verdict == "pass")
    passed = list(first.values())
    newest, before = passed[-NEWEST_OF_YIELD:], passed[:-NEWEST_OF_YIELD]
    if len(before) < NEWEST_OF_YIELD:
        return None
    table = [[sum(group), len(group) - sum(group)] for group in (newest, before)]
    if fisher_exact(table, alternative="less").pvalue >= DROP_CHANCE:
        return None
    return YieldDrop(sum(newest) / len(newest), sum(before) / len(before), len(newest))


def process_view(runs: Sequence[RunEntry], limit_rmse: float | None) -> ProcessView:
    """Return the control chart of accepted units and the capability of all, of runs in time order.

    What is not stable in the chart has no capability, for the reason that the chart shows.
    """
    every = [run for run in runs if run.predicted_rmse]
    accepted = [run for run in every if run.verdict in ACCEPTED]
    serials = tuple(run.serial for run in accepted)
    try:
        chart = control_chart(np.log10([run.predicted_rmse or 0.0 for run in accepted]))
    except InputError as error:
        return ProcessView(serials, None, (), None, error.reason)
    by_rule: dict[int, list[int]] = {}
    for signal in chart.signals:
        by_rule.setdefault(signal.rule, []).append(signal.index)
    broken = []
    for rule, at in sorted(by_rule.items()):
        starts = tuple(k for k in at if k - 1 not in at)
        broken.append(RuleBroken(rule, len(starts), serials[max(at)], rule in FORBIDDING, starts))
    try:
        errors = control_chart(np.log10([run.predicted_rmse or 0.0 for run in every])) if chart.is_stable else chart
        limit = None if limit_rmse is None else float(np.log10(limit_rmse))
        return ProcessView(serials, chart, tuple(broken), capability(errors, None, limit), None)
    except InputError as error:
        return ProcessView(serials, chart, tuple(broken), None, error.reason)
