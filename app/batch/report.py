"""What a batch says when it is done: a row per unit, for people and as JSON for programs."""

from dataclasses import dataclass

from softcal.app.batch.audit import LotAudit, audit_json, audit_line
from softcal.app.batch.train import TrainedOrFound
from softcal.core.quality.lot_release import LotRelease
from softcal.core.unit.verdict import VERDICTS, Release, Verdict, worst_of
from softcal.core.words.reason import Reason
from softcal.db.entries import UNIT_ERRORS, MadeCalibration

TABLE_HEADER = ("serial", "verdict", "predicted", "before", "after", "own", "after/own", "fit_s", "map")
ERRORS_AND_TIME = (*UNIT_ERRORS, "fit_s")


@dataclass(frozen=True)
class UnitResult:
    """One row of the report, reasons most important first. A unit that could not be read or mapped
    has no `made`. `is_new`: this batch fitted it, else the registry had it.
    """

    serial: str
    verdict: str
    reasons: tuple[Reason, ...]
    made: MadeCalibration | None = None
    is_new: bool = True


@dataclass(frozen=True, eq=False)
class BatchReport:
    """What a batch did: `audit` is where a planned audit of the lot stands, `release` which
    verdicts release files, `decided` what audits say about the lot's other units.
    """

    lot_id: str
    network: TrainedOrFound
    units: tuple[UnitResult, ...]
    wall_s: float
    audit: LotAudit | None = None
    release: Release = Release.PASS
    decided: LotRelease | None = None

    @property
    def counts(self) -> dict[str, int]:
        words = [unit.verdict for unit in self.units]
        return {str(word): words.count(word) for word in VERDICTS}

    @property
    def has_passed(self) -> bool:
        """Whether every unit passed: the exit code 0."""
        return worst_of(unit.verdict for unit in self.units) is Verdict.PASS

    def releases(self, unit: UnitResult) -> bool:
        """Whether files of this unit are written: by its verdict alone."""
        return unit.made is not None and self.release.releases(unit.verdict)


def report_json(report: BatchReport) -> dict[str, object]:
    """Return the report as the JSON of `softcal batch --json` (schema `softcal.batch/1`)."""
    units = []
    for unit in report.units:
        made = unit.made
        units.append(
            {
                "serial": unit.serial,
                "verdict": unit.verdict,
                "reasons": [str(why) for why in unit.reasons],
                "reason_codes": [why.code for why in unit.reasons],
                **{name: getattr(made, name, None) for name in ERRORS_AND_TIME},
                "map": made and {"family": made.family, "revision": made.revision, "sha256": made.map_sha256},
                "audited": made is not None and made.is_audited,
                "predicted_verdict": made and str(made.decision.predicted.verdict),
                "knowledge": made and made.knowledge,
                "released": report.releases(unit),
                "method": made and made.method_id,
                "is_new": unit.is_new,
            }
        )
    return {
        "schema": "softcal.batch/1",
        "lot": report.lot_id,
        "network": report.network.network.id,
        "network_is_new": report.network.is_new,
        "train_s": report.network.metrics.get("train_s"),
        "wall_s": report.wall_s,
        "counts": report.counts,
        "audit": None if report.audit is None else audit_json(report.audit),
        "release": None if report.decided is None else report.decided.to_json(),
        "units": units,
    }


def table_row(unit: UnitResult) -> list[object]:
    """Return one row of the table a person reads, under `TABLE_HEADER`."""
    made = unit.made
    if made is None:
        return [unit.serial, unit.verdict, *[None] * 7]
    ratio = made.after_rmse / made.own_rmse if made.after_rmse and made.own_rmse else None
    *errors, fit_s = (getattr(made, name) for name in ERRORS_AND_TIME)
    return [unit.serial, unit.verdict, *errors, ratio, fit_s, made.family]


def audit_lines(report: BatchReport) -> list[str]:
    """Return what audits say, a line each: units that are not as predicted, and the lot."""
    lines = []
    for unit in report.units:
        made = unit.made
        if made is not None and made.is_audited and made.decision.predicted.verdict != unit.verdict:
            lines.append(f"{unit.serial} audited: {unit.verdict}, was predicted {made.decision.predicted.verdict}")
    if report.decided is not None:
        lines.append(f"release: {report.decided.statement}")
    return lines if report.audit is None else [*lines, audit_line(report.audit)]
