"""Answers of the REST interface, as OpenAPI documents them; the values come from the use cases."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from softcal.core.orders import OrderKind, RunState

Instant = Annotated[str, Field(json_schema_extra={"format": "date-time"})]
Verdicts = Literal["pass", "conditional", "fail", "retest"]
Roles = Literal["operator", "engineer", "quality"]
Permissions = Literal["audit", "calibrate", "look", "override", "people", "release", "rollback", "set_limit", "set_up"]
JobKinds = Literal["archive", "calibrate", "compare", "demo", "diagnose", "station_check", "train"]
StationStates = Literal["starting", "off", "closed", "ready", "running", "stopped", "silent"]
EventTypes = Literal["softcal.verdict", "softcal.alert.raised", "softcal.alert.cleared", "softcal.change"]


class _Answer(BaseModel):
    # What a use case adds must not be lost, nor forgotten here.
    model_config = ConfigDict(extra="forbid")  # noqa: V107


class ProblemAnswer(_Answer):
    """An error, as RFC 9457 writes it; `detail` is the error line of the command."""

    type: str = "about:blank"
    title: str
    status: int
    detail: str


class AccountAnswer(_Answer):
    """Account of this token, and the rights of its role."""

    account: str
    role: Roles
    permissions: list[Permissions]
    version: str = Field(description="version of softcal")


class LotAnswer(_Answer):
    """A lot, its limit, and its units by verdict; `none` have no result yet."""

    lot: str
    source: str
    sample_rate_Hz: float
    sensor_model: str
    reference_quantity: str
    reference_unit: str
    output_unit: str
    limit_rmse: float | None
    counts: dict[str, int]


class _Page(_Answer):
    next: str | None = Field(description="what to give as `after` for the next page; null at the end")


class LotPageAnswer(_Page):
    """Some lots."""

    lots: list[LotAnswer]


class ReleaseAnswer(_Answer):
    """Release by sample, as in `softcal lot release --json`; null without units."""

    lot: str
    release: dict[str, Any] | None
    provenance: dict[str, Any] | None


class UnitAnswer(_Answer):
    """A unit of a lot, as in `softcal registry list --json`; errors in the reference unit of the lot."""

    lot_id: str
    serial: str
    role: Literal["source", "target"]
    verdict: Verdicts | None
    reasons: list[str]
    revision: int | None
    family: str | None
    map_sha256: str | None
    predicted_rmse: float | None
    before_rmse: float | None
    after_rmse: float | None
    own_rmse: float | None
    made_at: Instant | None
    is_conflict: bool
    is_stale: bool


class UnitPageAnswer(_Page):
    """Some units; `total` is how many the filter lets through."""

    units: list[UnitAnswer]
    total: int


class UnitsAnswer(_Page):
    """A serial in every lot that has it."""

    units: list[UnitAnswer]


class RevisionAnswer(_Answer):
    """One calibration of a unit; errors in the reference unit of the lot.

    `fit` is what its recording gave, `state` what was done to the unit since: trim, correction, release, audit, limit.
    """

    lot_id: str
    serial: str
    revision: int
    made_at: Instant
    actor: str
    reason: str
    rolled_back_to: int | None
    origin: str
    is_current: bool
    is_conflict: bool
    network_id: str
    family: str
    map_sha256: str
    verdict: Verdicts
    reasons: list[str]
    predicted_rmse: float | None
    before_rmse: float | None
    after_rmse: float | None
    own_rmse: float | None
    fit_s: float | None
    input_sha256: str
    recording_sha256: str
    proof_method: str | None
    method_id: str
    fit: dict[str, Any]
    state: dict[str, Any]
    provenance: dict[str, Any]


class RevisionsAnswer(_Page):
    """Every calibration of a unit, as in `softcal registry history --json`."""

    lot: str
    serial: str
    revisions: list[RevisionAnswer]


class JobRequest(_Answer):
    """A batch over a lot of the registry: f, maps and verdicts. Stored results are not computed again."""

    kind: Literal["calibrate"] = "calibrate"
    lot: Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_ .+-]{0,63}$")]
    map: Annotated[str | None, Field(description="family of every map, as `softcal batch --map`")] = None


class JobAnswer(_Answer):
    """A job with its progress. `is_lost`: its process has no heartbeat."""

    job_id: str
    kind: JobKinds
    request: dict[str, Any]
    actor: str
    created: Instant
    state: RunState
    fraction: float
    message: str
    is_cancel_wanted: bool
    is_lost: bool
    result: dict[str, Any]


class JobsAnswer(_Page):
    """The newest jobs, newest first; `result` is empty here."""

    jobs: list[JobAnswer]


class StationAnswer(_Answer):
    """A station: its state (`silent` without a heartbeat), the unit in the fixture and the last decided unit."""

    station: str
    state: StationStates
    at: Instant
    reasons: list[str]
    serial: str | None
    last_serial: str | None  # noqa: V107
    last_lot: str | None
    last_verdict: Verdicts | None  # noqa: V107
    lot: str | None
    counts: dict[str, int]


class StationsAnswer(_Page):
    """All stations by name."""

    stations: list[StationAnswer]


class OrderAnswer(_Answer):
    """An order to a station with its progress."""

    order_id: str
    station: str
    kind: OrderKind
    serial: str | None
    lot: str | None
    actor: str
    created: Instant | None
    state: RunState
    phase: str
    fraction: float
    code: str
    message: str
    verdict: Verdicts | None


class OrdersAnswer(_Page):
    """The newest orders, newest first."""

    orders: list[OrderAnswer]


class EventAnswer(_Answer):
    """An event as CloudEvents 1.0 writes it; `id` never changes."""

    specversion: Literal["1.0"]  # noqa: V107
    id: str
    source: str
    type: EventTypes
    time: Instant
    subject: str
    datacontenttype: str  # noqa: V107
    data: dict[str, Any]


class EventsAnswer(_Answer):
    """Events in order; give `next` as `after`. If `is_end` is true, repeat the request later."""

    events: list[EventAnswer]
    next: str
    is_end: bool


class AlertAnswer(_Answer):
    """An alert: its kind, its values (`values`), and its sentence by language."""

    kind: str
    lot: str | None
    is_urgent: bool
    values: dict[str, Any]
    text: dict[str, str]
    since: Instant


class AlertsAnswer(_Page):
    """The alerts that are open."""

    alerts: list[AlertAnswer]
