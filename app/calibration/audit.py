"""Audits of a lot: which units to check with the load cell, and what their results say."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from softcal.app.registry.limit import lot_limit
from softcal.app.registry.lot_recordings import newest_audits, target_serials
from softcal.app.texts.reasons import Translator
from softcal.core.errors import InputError
from softcal.core.quality.audit_plan import AuditConfig, AuditPlan, LotStatement, evaluate_audit, plan_audit
from softcal.core.unit.verdict import Limit, Verdict
from softcal.db.entries import Draw, UnitEntry
from softcal.db.registry import Registry


@dataclass(frozen=True)
class Sample:
    """What of a lot's audits was drawn at random before it was measured.

    Args:
        drawn, population: units drawn at random, and of how many the lot has.
        drawn_at, last_drawn_at: when the first and the last of them were, UTC; None without a draw.
        since, before: drawn units measured after the draw, and before it.
        without_draw: other units that were audited.
    """

    drawn: int
    population: int
    drawn_at: datetime | None
    last_drawn_at: datetime | None
    since: int
    before: int
    without_draw: int

    def to_json(self) -> dict[str, object]:
        """Return the sample as JSON values."""
        instants = {"drawn_at": self.drawn_at, "last_drawn_at": self.last_drawn_at}
        return vars(self) | {name: at and at.isoformat() for name, at in instants.items()}

    def render(self, translate: Translator) -> str:
        """Return in one sentence how the audits stand to the draw."""
        if self.drawn_at is None or self.last_drawn_at is None:
            return translate("paper.drawn.not", others=self.without_draw)
        numbers = {"since": self.since, "before": self.before, "others": self.without_draw}
        days = sorted({at.date().isoformat() for at in (self.drawn_at, self.last_drawn_at)})
        day = " – ".join(days)
        return translate("paper.drawn.is", drawn=self.drawn, population=self.population, day=day, **numbers)


def _draw_instants(draws: Sequence[Draw]) -> dict[str, datetime]:
    """Return when each unit was first drawn at random, UTC."""
    return {serial: one.made_at for one in reversed(draws) for serial in one.plan.random}


def find_random_audits(registry: Registry, lot_id: str) -> frozenset[str]:
    """Return the audited units of a lot that were drawn at random before they were measured: they alone are a sample.

    A recording counts as measured by its own stamps or as stated, else when the registry first saw it.
    """
    audits, instants = newest_audits(registry, lot_id), _draw_instants(registry.declarations.draws(lot_id))
    return frozenset(serial for serial, at in instants.items() if serial in audits and audits[serial].observed_at > at)


def audited_sample(registry: Registry, lot_id: str) -> Sample:
    """Return how the audits of a lot stand to its draws."""
    audits, instants = newest_audits(registry, lot_id), _draw_instants(registry.declarations.draws(lot_id))
    since, drawn_count = len(find_random_audits(registry, lot_id)), len(audits.keys() & instants.keys())
    first, last = (end(instants.values(), default=None) for end in (min, max))
    units = len(target_serials(registry, lot_id))
    return Sample(len(instants), units, first, last, since, drawn_count - since, len(audits) - drawn_count)


@dataclass(frozen=True, eq=False)
class LotAudit:
    """Where the audit of a lot stands.

    Args:
        forecasts: RMSE by serial when the plan was drawn.
        limit: in force.
        measured: RMSE against the load cell, of units drawn at random since the draw.
        measured_before: the same of units that were drawn at random afterwards: they are no sample.
        statement: what they say of the lot once all were measured; None before, and without a stated limit.
    """

    plan: AuditPlan
    forecasts: Mapping[str, float]
    limit: Limit
    measured: Mapping[str, float]
    measured_before: Mapping[str, float]
    statement: LotStatement | None

    @property
    def missing(self) -> tuple[str, ...]:
        return tuple(serial for serial in self.plan.serials if serial not in self.measured)

    @property
    def rows(self) -> Iterator[tuple[str, str, float, float | None, str]]:
        """Each unit of the plan: serial, why it was drawn, forecast, measured, what that says."""
        for serial in self.plan.serials:
            cause = "doubtful" if serial in self.plan.doubtful else "random"
            measured = self.measured.get(serial, self.measured_before.get(serial))
            yield serial, cause, self.forecasts[serial], measured, self._result(serial)

    def _result(self, serial: str) -> str:
        if serial not in self.measured:
            return "before" if serial in self.measured_before else "open"
        if not self.limit.is_stated:
            return "no_limit"
        return "within" if self.measured[serial] <= self.limit.maximum_rmse else "beyond"


def draw_plan(
    registry: Registry, lot_id: str, config: AuditConfig, *, reason: str = "", actor: str | None = None
) -> LotAudit:
    """Draw which accepted units of a lot to check, and write it down before anything is measured. A
    random sample that one may repeat until it pleases says nothing.

    Raises:
        InputError: no unit was accepted yet, or a plan stands and no reason was given.
    """
    if registry.declarations.draws(lot_id) and not reason.strip():
        raise InputError(f"lot {lot_id!r} has an audit plan; a new draw needs a reason")
    # Forecasts of the units that audits can speak for; their forecast alone may speak against them
    units = {unit.serial: unit for unit in _targets(registry, lot_id) if unit.predicted_rmse is not None}
    unit_statuses = registry.pages.unit_statuses(lot_id, list(units))
    unchecked = {
        serial
        for serial, status in unit_statuses.items()
        if (one := status.calibration) is not None and one.state.fit.is_open and one.state.decision.measured is None
    }
    accepted = {
        serial: float(unit.predicted_rmse or 0.0)
        for serial, unit in units.items()
        if serial in unchecked or (unit.verdict and Verdict(unit.verdict).is_open)
    }
    if not accepted:
        raise InputError(f"lot {lot_id!r} has no accepted unit yet; calibrate its units first")
    plan = plan_audit(accepted, config)
    forecasts = {serial: accepted[serial] for serial in plan.serials}
    registry.declarations.add_draw(lot_id, plan, forecasts, config, actor=actor, reason=reason)
    return _read_audit(registry, registry.declarations.draws(lot_id)[-1])


def lot_audit(registry: Registry, lot_id: str) -> LotAudit | None:
    """Return the newest audit plan of a lot with what was measured since; None without one."""
    draws = registry.declarations.draws(lot_id)
    return _read_audit(registry, draws[-1]) if draws else None


def update_lot(registry: Registry, lot_id: str, actor: str | None = None) -> LotAudit | None:
    """Judge the lot by its audits as far as they are in, and keep a new statement."""
    audit = lot_audit(registry, lot_id)
    if audit is not None and audit.statement is not None:
        failed = set(audit.statement.failed)
        values = {name: value for name, value in vars(audit.statement).items() if name != "failed"} | {"lot_id": lot_id}
        values["listed"] = [
            {"serial": serial, "measured_rmse": error, "is_failed": serial in failed}
            for serial, error in sorted(audit.measured.items())
        ]
        registry.declarations.declare("lot_statements", values, action="judge", actor=actor)
    return audit


def audit_json(audit: LotAudit) -> dict[str, object]:
    """Return where an audit stands as JSON values: schema `softcal.lot.audit/1`."""
    statement = audit.statement and vars(audit.statement) | {"failed": list(audit.statement.failed)}
    return {
        "schema": "softcal.lot.audit/1",
        "plan": audit.plan.settings(),
        "limit_rmse": audit.limit.stated_rmse,
        "predicted_rmse": dict(audit.forecasts),
        "measured_rmse": dict(audit.measured),
        "measured_before": dict(audit.measured_before),
        "missing": list(audit.missing),
        "verdict": None if audit.statement is None else audit.statement.word,
        "statement": statement,
    }


AUDIT_HEADER = ("serial", "why", "predicted", "measured", "result")
LABELS = {
    "random": "random",
    "doubtful": "largest predicted error",
    "open": "to be measured",
    "before": "measured before the draw",
    "no_limit": "no limit was stated",
    "within": "within",
    "beyond": "misses the limit",
}


def audit_rows(audit: LotAudit) -> list[list[object]]:
    """Return one row per unit of the plan under `AUDIT_HEADER`."""
    return [[serial, LABELS[cause], *errors, LABELS[result]] for serial, cause, *errors, result in audit.rows]


def audit_line(audit: LotAudit) -> str:
    """Return in one line where the audit of a lot stands."""
    if audit.statement is None:
        missing = ", ".join(audit.missing[:8]) + (" ..." if len(audit.missing) > 8 else "")
        to_do = f"still to press: {missing}" if missing else "no limit was stated, so nothing is said of the lot"
        return f"audit: {len(audit.measured)} of {len(audit.plan.serials)} units measured since the draw; {to_do}"
    return f"audit: lot {audit.statement.word}: {audit.statement.text}"


def _read_audit(registry: Registry, draw: Draw) -> LotAudit:
    plan, limit = draw.plan, lot_limit(registry, draw.lot_id)
    errors = {unit.serial: unit.after_rmse for unit in _targets(registry, draw.lot_id)}
    measured = {s: float(e) for s in plan.serials if (e := errors.get(s)) is not None}
    audits = newest_audits(registry, draw.lot_id)
    early = {s for s in measured if s in plan.random and s in audits and audits[s].observed_at <= draw.made_at}
    before, since = ({s: e for s, e in measured.items() if (s in early) == is_early} for is_early in (True, False))
    is_complete = limit.is_stated and len(since) == len(plan.serials)
    statement = evaluate_audit(plan, draw.forecasts, since, limit) if is_complete else None
    return LotAudit(plan, draw.forecasts, limit, since, before, statement)


def _targets(registry: Registry, lot_id: str) -> list[UnitEntry]:
    return [unit for unit in registry.lots.units(lot_id) if unit.role == "target"]


def confirmed_audits(registry: Registry, lot_id: str) -> dict[str, str]:
    """Return the audits that a person confirmed: by serial, the hash of their output."""
    rows = registry.declarations.in_force("confirmed_audits", lot_id)
    return {row["serial"]: row["output_sha256"] for row in rows}
