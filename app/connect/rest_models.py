"""What the REST answers hold, as OpenAPI shows it; the values come from the use cases."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

Instant = Annotated[str, Field(json_schema_extra={"format": "date-time"})]
Verdicts = Literal["pass", "conditional", "fail", "retest"]


class _Answer(BaseModel):
    # What a use case adds must not be lost, nor forgotten here.
    model_config = ConfigDict(extra="forbid")


class ProblemAnswer(_Answer):
    """An error, as RFC 9457 writes it; `detail` is the line the command would say."""

    type: str = "about:blank"
    title: str
    status: int
    detail: str


class AccountAnswer(_Answer):
    """Whose token this is, and what the role allows."""

    account: str
    role: str
    permissions: list[str]
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


class LotPageAnswer(_Answer):
    """Some lots; `next` is what to give as `after`, null at the end."""

    lots: list[LotAnswer]
    next: str | None


class ReleaseAnswer(_Answer):
    """What is promised about the units nobody measured, as `softcal lot release --json` says it; null without units."""

    lot: str
    release: dict[str, Any] | None


class UnitAnswer(_Answer):
    """A unit of a lot, as `softcal registry list --json` says it; errors in the reference unit of the lot."""

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


class UnitPageAnswer(_Answer):
    """Some units; `total` is how many the filter lets through, `next` the number of the next page, null at the end."""

    units: list[UnitAnswer]
    total: int
    next: int | None


class UnitsAnswer(_Answer):
    """A serial in every lot it stands in."""

    units: list[UnitAnswer]


class RevisionsAnswer(_Answer):
    """Every calibration of a unit, as `softcal registry history --json` says it."""

    lot: str
    serial: str
    revisions: list[dict[str, Any]]


class JobRequest(_Answer):
    """A batch over a lot of the registry: train or reuse f, fit every unit, verdicts. What is known is not repeated."""

    kind: Literal["calibrate"] = "calibrate"
    lot: Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_ .+-]{0,63}$")]


class JobAnswer(_Answer):
    """A job and how far it is. `is_lost`: its process gives no sign of life."""

    job_id: str
    kind: str
    request: dict[str, Any]
    actor: str
    created: Instant
    state: Literal["queued", "running", "done", "error", "cancelled"]
    fraction: float
    message: str
    is_cancel_wanted: bool
    is_lost: bool
    result: dict[str, Any]


class JobsAnswer(_Answer):
    """The newest jobs, newest first; `result` is empty here."""

    jobs: list[JobAnswer]


class StationAnswer(_Answer):
    """A station: its state (`silent` without a sign of life), the unit it presses and the last one it judged."""

    station: str
    state: str
    at: Instant
    reasons: list[str]
    serial: str | None
    last_serial: str | None
    last_verdict: str | None
    lot: str | None
    counts: dict[str, int]


class StationsAnswer(_Answer):
    """All stations by name."""

    stations: list[StationAnswer]


class OrderAnswer(_Answer):
    """An order to a station and how far it is."""

    order_id: str
    station: str
    kind: str
    serial: str | None
    lot: str | None
    actor: str
    created: Instant | None
    state: str
    phase: str
    fraction: float
    code: str
    message: str
    verdict: str | None


class OrdersAnswer(_Answer):
    """The newest orders, newest first."""

    orders: list[OrderAnswer]


class EventAnswer(_Answer):
    """An event as CloudEvents 1.0 writes it; `id` is the same for ever."""

    specversion: Literal["1.0"]
    id: str
    source: str
    type: str
    time: Instant
    subject: str
    datacontenttype: str
    data: dict[str, Any]


class EventsAnswer(_Answer):
    """Events in their order; `next` is what to give as `after`. Where `is_end` is true, ask again later with it."""

    events: list[EventAnswer]
    next: str
    is_end: bool


class AlertsAnswer(_Answer):
    """The alerts that are open, with their sentence in every language."""

    alerts: list[dict[str, Any]]
