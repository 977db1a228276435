"""Report of a batch: a row per unit, for people and as JSON for programs."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from softcal.app.batch.train import LotNetwork
from softcal.app.calibration.audit import LotAudit, audit_json, audit_line
from softcal.app.calibration.changes import Changes
from softcal.app.calibration.lot_fit import LotFitPlan
from softcal.app.files.unused_input import UnusedInput
from softcal.app.texts.reason_groups import MAX_NAMES, name_serials
from softcal.core.messages.reason import Reason
from softcal.core.quality.lot_release import LotRelease
from softcal.core.unit.verdict import VERDICTS, Release, Verdict, worst_of
from softcal.db.entries import UnitResult

OWN_RATIO = "after/own, test rows"
"""Heading of the one ratio whose errors are of other rows than `after`: those the own calibration was tested on."""

TABLE_HEADER = ("serial", "verdict", "predicted", "before", "after", "own", OWN_RATIO, "fit_s", "map")


@dataclass(frozen=True, eq=False)
class BatchReport:
    """Result of a batch.

    `audit` is the state of the lot's audit plan, `release` the verdicts that release files, `decided` the statement of
    audits about the lot's other units, `not_used` the unused parts of the folder, `remarks` the irregularities that
    are no errors, `layouts` the layout of each file read now, "" for the plain form, `changes` the replaced verdicts,
    `lot_fit` the units mapped together now, and the possible ones.
    """

    lot_id: str
    network: LotNetwork
    units: tuple[UnitResult, ...]
    wall_s: float
    audit: LotAudit | None = None
    release: Release = Release.PASS
    decided: LotRelease | None = None
    not_used: tuple[UnusedInput, ...] = ()
    remarks: tuple[Reason | str, ...] = ()
    layouts: Mapping[str, str] = field(default_factory=dict)
    changes: Changes = Changes((), {})  # noqa: RUF009 - frozen
    lot_fit: LotFitPlan | None = None

    @property
    def counts(self) -> dict[str, int]:
        verdicts = [unit.verdict for unit in self.units]
        return {str(word): verdicts.count(word) for word in VERDICTS}

    @property
    def has_passed(self) -> bool:
        """Whether every unit passed: the exit code 0."""
        return worst_of(unit.verdict for unit in self.units) is Verdict.PASS

    def releases(self, unit: UnitResult) -> bool:
        """Whether files of this unit are written: by its verdict alone."""
        return unit.calibration is not None and self.release.releases(unit.verdict)


def unused_audits(audit_paths: Mapping[str, Path], units: Sequence[UnitResult]) -> list[UnusedInput]:
    """Return the audits in a lot folder that decide about no unit, each with why."""
    items = []
    for unit in units:
        path = audit_paths.get(unit.serial)
        if path is None or unit.is_audited:
            continue
        cause = None if unit.state is None else unit.state.suspect_audit or unit.state.unreadable_audit
        items.append(UnusedInput("audit", unit.serial, cause or unit.reasons[0], f"audit/{path.name}"))
    return items


def report_json(report: BatchReport) -> dict[str, object]:
    """Return the report as the JSON of `softcal batch --json` (schema `softcal.batch/1`)."""
    units = []
    for unit in report.units:
        stored, state = unit.calibration, unit.state
        map_json = stored and {
            "family": stored.state.fit.family,
            "revision": stored.revision,
            "sha256": stored.map_sha256,
            "lot_fit": stored.state.fit.lot_fit and vars(stored.state.fit.lot_fit),
        }
        units.append(
            {
                **unit.to_json(),
                "map": map_json,
                "audit_scores": None if state is None or state.scores is None else asdict(state.scores),
                "predicted_verdict": state and str(state.decision.predicted.verdict),
                "missing": None if state is None or state.fit.missing is None else state.fit.missing.numbers(),
                "method": state and state.fit.method.id,
                "is_new": unit.is_new,
                "provenance": stored and stored.provenance.to_json(),
            }
        )
    passed = [unit.serial for unit in report.units if unit.verdict == Verdict.PASS]
    return {
        "schema": "softcal.batch/1",
        "lot": report.lot_id,
        "network": report.network.network.id,
        "network_is_new": report.network.is_new,
        "train_s": report.network.metrics.get("train_s"),
        "wall_s": report.wall_s,
        "counts": report.counts,
        "audit": None if report.audit is None else audit_json(report.audit),
        "release": None if report.decided is None else {**report.decided.to_json(), "released": passed},
        "units": units,
        "audits": sum(unit.is_audited for unit in report.units),
        "not_used": [item.to_json() for item in report.not_used],
        "remarks": [str(remark) for remark in report.remarks],
        "changes": report.changes.to_json(),
        "lot_fit": report.lot_fit and report.lot_fit.to_json(),
        "layouts": dict(report.layouts),
    }


def table_row(unit: UnitResult) -> list[object]:
    """Return one row of the table a person reads, under `TABLE_HEADER`."""
    state = unit.state
    if state is None:
        return [unit.serial, unit.verdict, *[None] * 7]
    own_scores = None if state.scores is None else state.scores.own
    ratio = None if own_scores is None else own_scores.after_ratio
    return [unit.serial, unit.verdict, *unit.errors.values(), ratio, state.fit.fit_s, state.fit.family]


def audit_lines(report: BatchReport) -> list[str]:
    """Return one line per result of audits: units with a wrong forecast, and the lot."""
    groups: dict[tuple[str, str], list[str]] = {}
    for unit in report.units:
        state = unit.state
        if state is not None and unit.is_audited and state.decision.predicted.verdict != unit.verdict:
            groups.setdefault((unit.verdict, state.decision.predicted.verdict), []).append(unit.serial)
    lines = [
        f"{name_serials(serials)} audited: {verdict}, {'was' if len(serials) == 1 else 'were'} predicted {predicted}"
        for (verdict, predicted), serials in groups.items()
    ]
    if withdrawn := [f"{one.serial} of {one.lot_id}" for one in report.changes.withdrawn]:
        more = f" and {len(withdrawn) - MAX_NAMES} more" if len(withdrawn) > MAX_NAMES else ""
        lines.append(f"withdrawn: {', '.join(withdrawn[:MAX_NAMES])}{more}: released before, and no more")
    if report.lot_fit is not None:
        lines += map(str, report.lot_fit.batch_messages)
    if report.decided is not None:
        lines.append(f"release: {report.decided.statement}")
    return lines if report.audit is None else [*lines, audit_line(report.audit)]
