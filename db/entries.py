"""Return values of the registry: frozen dataclasses, never rows of a table."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date, datetime, timedelta
from typing import TYPE_CHECKING

from softcal.core.errors import InputError
from softcal.core.lot import UnitKey
from softcal.core.messages.reason import Reason
from softcal.core.quality.line_rules import LineRules
from softcal.db.provenance import Provenance

if TYPE_CHECKING:
    from softcal.core.quality.audit_plan import AuditPlan
    from softcal.core.unit.state import UnitState

Heads = dict[str, tuple[int, str]]
"""Number and hash of the last row of each chain of the audit trail."""


@dataclass(frozen=True)
class UnitEntry:
    """A unit of a lot and its status.

    Args:
        serial: two lots may have it.
        verdict: of the newest result; None without one.
        reasons: why, most important first.
        revision, family, map_sha256, state_sha256, predicted_rmse, before_rmse, after_rmse, own_rmse: of the newest
            calibration of this lot; None without one.
        made_at: when the newest result was made, UTC.
        is_conflict: two registries put different maps into use; a person has to decide.
        is_stale: its calibration has another method; a batch computes it again.
    """

    lot_id: str
    serial: str
    role: str
    verdict: str | None = None
    reasons: tuple[Reason, ...] = ()
    revision: int | None = None
    family: str | None = None
    map_sha256: str | None = None
    state_sha256: str | None = None
    predicted_rmse: float | None = None
    before_rmse: float | None = None
    after_rmse: float | None = None
    own_rmse: float | None = None
    made_at: datetime | None = None
    is_conflict: bool = False
    is_stale: bool = False

    @property
    def key(self) -> UnitKey:
        return UnitKey(self.lot_id, self.serial)

    @property
    def errors(self) -> tuple[float | None, ...]:
        """Its errors in the lot's reference unit, in the order of `UNIT_ERRORS`."""
        return self.predicted_rmse, self.before_rmse, self.after_rmse, self.own_rmse


@dataclass(frozen=True)
class RunEntry:
    """One result of one unit, good or not, in order of creation, without rollbacks."""

    serial: str
    made_at: datetime
    verdict: str
    reasons: tuple[Reason, ...]
    predicted_rmse: float | None = None


@dataclass(frozen=True, eq=False)
class StoredCalibration:
    """One revision of a unit's state.

    Args:
        state: as a row of many without arrays, so that a lot of ten thousand fits into memory: it can be decided on and
            estimates nothing.
        map_sha256: content hash of the map in force.
        revision: 1, 2, 3 ... per serial.
        input_sha256: content hash of what asked for it.
        made_at: UTC; never before the revision it follows.
        version, build: of the program that made it.
        rolled_back_to: the older revision this one repeats, for a rollback.
        origin: the registry that wrote it.
        is_current: this is the map in use in its lot. None is while two registries disagree.
        is_conflict: this map and another one are in use; a person has to decide.
    """

    state: "UnitState"
    lot_id: str
    map_sha256: str
    revision: int
    input_sha256: str
    made_at: datetime
    actor: str
    reason: str
    version: str
    build: str
    rolled_back_to: int | None
    origin: str
    is_current: bool
    is_conflict: bool

    @property
    def serial(self) -> str:
        return self.state.serial

    @property
    def key(self) -> UnitKey:
        return UnitKey(self.lot_id, self.serial)

    @property
    def provenance(self) -> Provenance:
        """Provenance of this revision."""
        fit, audit = self.state.fit, self.state.audit
        inputs = {"request": self.input_sha256, "network": fit.network_id, "recording": fit.recording_sha256}
        return Provenance(
            version=self.version,
            build=self.build,
            method=fit.method.id,
            inputs=inputs if audit is None else inputs | {"audit": audit.recording_sha256},
            made_at=self.made_at.isoformat(),
            actor=self.actor,
        )


UNIT_ERRORS = ("predicted_rmse", "before_rmse", "after_rmse", "own_rmse")
"""The errors of a calibration in the lot's reference unit: as forecast, then as an audit showed them."""

UNDECIDED = "retest"
"""Verdict of a unit for which two registries put different maps into use."""


@dataclass(frozen=True, eq=False)
class UnitResult:
    """Status of a unit with its reasons and time (UTC), as every report states it.

    Args:
        verdict: of the newest result; "" while there is none.
        reasons: why, most important first.
        made_at: UTC; None while there is no result.
        calibration: the one in use; None after a refusal or in a conflict.
        is_new: whether the batch that reports it fitted it.
    """

    serial: str
    verdict: str = ""
    reasons: tuple[Reason, ...] = ()
    made_at: datetime | None = None
    calibration: StoredCalibration | None = None
    is_new: bool = False

    @property
    def state(self) -> "UnitState | None":
        return None if self.calibration is None else self.calibration.state

    @property
    def is_audited(self) -> bool:
        return self.state is not None and self.state.decision.is_audited

    @property
    def errors(self) -> dict[str, float | None]:
        """Its errors in the lot's reference unit, by `UNIT_ERRORS`; None where there is none."""
        return dict.fromkeys(UNIT_ERRORS) if self.state is None else self.state.errors

    def to_json(self) -> dict[str, object]:
        """Return what every machine-readable result says of the unit."""
        state = self.state
        return {
            "serial": self.serial,
            "verdict": self.verdict,
            "reasons": [str(why) for why in self.reasons],
            "reason_codes": [why.code for why in self.reasons],
            "released": self.verdict == "pass",
            "audited": self.is_audited,
            "knowledge": state and str(state.correspondence),
            "fit_s": state and state.fit.fit_s,
            **self.errors,
        }


@dataclass(frozen=True)
class NetworkEntry:
    """Metadata of a shared network without its weights; `input_sha256` identifies its training input."""

    id: str
    lot_id: str
    input_sha256: str
    training: Mapping[str, object]
    metrics: Mapping[str, object]
    added_at: datetime


INSTANTS_AGREE = timedelta(days=1)
"""Two statements of when one thing was measured agree within it: clocks are set by hand, and a date has no time."""


@dataclass(frozen=True)
class RecordingEntry:
    """Metadata of a recording (source, unit or audit) without samples; `sha256` covers its whole content.

    `proof_method` is the identity of the method by which a station proved it; None for a file that was brought.
    """

    sha256: str
    lot_id: str
    serial: str
    kind: str
    samples: int
    sample_rate_Hz: float
    output_unit: str
    reference_unit: str | None
    output_sha256: str
    added_at: datetime
    measured_at: datetime | None = None
    proof_method: str | None = None

    @property
    def observed_at(self) -> datetime:
        """Time of the measurement: from the recording's stamps, or as stated, at the latest the first import."""
        return min(self.measured_at or self.added_at, self.added_at)


@dataclass(frozen=True)
class LotDecisionEntry:
    """One decision on a lot (number 1, 2, 3 ... per lot), as JSON values."""

    lot_id: str
    number: int
    origin: str
    made_at: datetime
    actor: str
    reason: str
    version: str
    build: str
    decision: Mapping[str, object]


@dataclass(frozen=True)
class Draw:
    """A random sample of a lot, stored before its audits: forecasts by serial, and the time (UTC)."""

    lot_id: str
    plan: "AuditPlan"
    forecasts: Mapping[str, float]
    made_at: datetime


@dataclass(frozen=True)
class LimitEntry:
    """One version (1, 2, 3 ... per lot) of a lot's limit, the largest RMSE; None for the source's own error."""

    lot_id: str
    version: int
    rmse: float | None
    made_at: datetime
    actor: str
    reason: str


@dataclass(frozen=True)
class LineRulesEntry:
    """One version of a lot's rules at the line."""

    lot_id: str
    version: int
    rules: LineRules
    made_at: datetime
    actor: str
    reason: str


@dataclass(frozen=True)
class AuditRow:
    """One row of the audit trail: actor, action, time and reason; `key`, `before`, `after` are JSON."""

    origin: str
    seq: int
    at: datetime
    actor: str
    action: str
    entity: str
    key: str
    before: str | None
    after: str | None
    reason: str
    prev_hash: str
    hash: str


@dataclass(frozen=True)
class Anchor:
    """Last rows of the audit trail as recorded in a file; `where` gives the file and its time."""

    heads: Heads
    where: str


@dataclass(frozen=True)
class CellCertificate:
    """Certificate of a load cell, as far as gate and uncertainty budget need it.

    Args:
        issued_on, due_on: first day it holds, first day it no longer holds.
        capacity_N: largest force it covers.
        uncertainty_N: expanded uncertainty (k = 2) over its range, in N.
    """

    cell_serial: str
    number: str
    laboratory: str
    issued_on: date
    due_on: date
    capacity_N: float
    uncertainty_N: float
    document: bytes | None = None

    def __post_init__(self) -> None:
        if not self.due_on > self.issued_on:
            raise InputError(f"certificate {self.number}: due on {self.due_on}, which is not after {self.issued_on}")
        if not (0 < self.capacity_N < float("inf") and 0 < self.uncertainty_N < float("inf")):
            raise InputError(f"certificate {self.number}: capacity and uncertainty must be positive numbers of N")

    def is_valid(self, on: date) -> bool:
        return self.issued_on <= on < self.due_on


@dataclass(frozen=True)
class GoldenRun:
    """One check of a station with a golden unit: the charted value in `unit`, and whether it passed."""

    station: str
    lot_id: str
    serial: str
    made_at: datetime
    value: float
    unit: str
    passed: bool
    reasons: tuple[Reason, ...] = ()
    actor: str = ""
    recording_sha256: str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "reasons", tuple(map(Reason.parse, self.reasons)))


ROLES = ("operator", "engineer", "quality")
"""Of people and programs; `access.people` says what each may do."""


@dataclass(frozen=True)
class User:
    """A person with a role, without the PIN; `is_alone` if no other account exists and the role assigns roles."""

    name: str
    role: str
    is_active: bool
    version: int
    is_alone: bool = False


@dataclass(frozen=True)
class Token:
    """Token by which a program signs in, without its secret.

    Args:
        token_id: its name in commands and in the audit trail.
        account: whose role says what it may.
        created, ends_at: from when until when it holds, UTC.
    """

    token_id: str
    account: str
    purpose: str
    created: datetime
    ends_at: datetime
    is_withdrawn: bool

    def holds(self, now: datetime) -> bool:
        """Return whether a program may sign in with the token now, as far as the token itself decides."""
        return not self.is_withdrawn and self.created <= now < self.ends_at
