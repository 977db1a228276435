"""The tables of the registry. Their history is in `migrations/`; `SCHEMA` names the step these definitions equal."""

import json
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import (
    BigInteger,
    Boolean,
    CheckConstraint,
    Column,
    Date,
    DateTime,
    Dialect,
    Double,
    ForeignKey,
    ForeignKeyConstraint,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Table,
    Text,
    false,
)
from sqlalchemy.types import TypeDecorator

from softcal.core.errors import RegistryError

SCHEMA = "0009"
"""Revision of the newest migration: what a registry must have to be used by this version."""

metadata = MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "ck": "ck_%(table_name)s_%(constraint_name)s",
        "fk": "fk_%(table_name)s_%(column_0_N_name)s_%(referred_table_name)s",
        "pk": "pk_%(table_name)s",
    }
)


def _read_or_damaged(process: Any) -> Any:
    """Say of a value that cannot be read that the registry is damaged: softcal has never written it."""

    def read(value: Any) -> Any:
        try:
            return value if process is None else process(value)
        except (ValueError, TypeError) as error:
            raise RegistryError(
                f"the registry holds {str(value)[:40]!r} where a value was written; it is damaged; run `softcal "
                "registry verify` and go back to a backup"
            ) from error

    return read


class UtcTime(TypeDecorator[datetime]):
    """An instant in UTC; a time without zone is refused. SQLite would drop the zone without a word."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        if value is None:
            return None
        if value.tzinfo is None:
            raise ValueError(f"{value} has no time zone; give an instant in UTC")
        return value.astimezone(UTC)

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)

    def result_processor(self, dialect: Dialect, coltype: object) -> Any:
        return _read_or_damaged(_of_text(super().result_processor(dialect, coltype)))


def _of_text(process: Any) -> Any:
    """Refuse an instant that SQLite keeps in other words: it would read as the same and sort as another one."""

    def read(value: Any) -> Any:
        instant = process(value)
        if isinstance(value, str) and value != instant.strftime("%Y-%m-%d %H:%M:%S.%f"):
            raise ValueError(value)
        return instant

    return read


class CanonicalJson(TypeDecorator[Any]):
    """JSON as text with sorted keys, so that equal values have equal bytes on every database. NaN is refused."""

    impl = Text
    cache_ok = True

    def process_bind_param(self, value: Any, dialect: Dialect) -> str | None:
        return None if value is None else canonical_json(value)

    def process_result_value(self, value: str | None, dialect: Dialect) -> Any:
        return None if value is None else json.loads(value)

    def result_processor(self, dialect: Dialect, coltype: object) -> Any:
        return _read_or_damaged(super().result_processor(dialect, coltype))


ENCODER = json.JSONEncoder(sort_keys=True, separators=(",", ":"), allow_nan=False)


def canonical_json(value: object) -> str:
    """Return JSON text that is the same for equal values."""
    return ENCODER.encode(value)


def sha256_column(name: str, *rest: Any, **options: Any) -> Column[str]:
    """Return a column for a content hash in hex."""
    return Column(name, String(64), *rest, **options)


registry_info = Table(
    "registry_info",
    metadata,
    Column("key", String(64), primary_key=True),
    Column("value", Text, nullable=False),
)

blobs = Table(
    "blobs",
    metadata,
    sha256_column("sha256", primary_key=True),
    Column("kind", String(16), nullable=False),
    Column("size", Integer, nullable=False),
    Column("data", LargeBinary, nullable=False),
)

lots = Table(
    "lots",
    metadata,
    Column("id", String(64), primary_key=True),
    Column("source", String(64), nullable=False),
    Column("sample_rate_Hz", Double, nullable=False),
    Column("sensor_model", Text, nullable=False),
    Column("reference_quantity", Text, nullable=False),
    Column("reference_unit", Text, nullable=False),
    Column("output_unit", Text, nullable=False),
    Column("added_at", UtcTime, nullable=False),
)

limits = Table(
    "limits",
    metadata,
    Column("lot_id", ForeignKey("lots.id"), primary_key=True),
    Column("version", Integer, primary_key=True),
    Column("origin", String(32), primary_key=True),
    Column("rmse", Double),
    Column("made_at", UtcTime, nullable=False),
    Column("actor", Text, nullable=False),
    Column("reason", Text, nullable=False),
    CheckConstraint("version >= 1", name="version"),
)

line_rules = Table(
    "line_rules",
    metadata,
    Column("lot_id", ForeignKey("lots.id"), primary_key=True),
    Column("version", Integer, primary_key=True),
    Column("origin", String(32), primary_key=True),
    Column("rules", CanonicalJson, nullable=False),
    Column("made_at", UtcTime, nullable=False),
    Column("actor", Text, nullable=False),
    Column("reason", Text, nullable=False),
    CheckConstraint("version >= 1", name="version"),
)

units = Table(
    "units",
    metadata,
    Column("lot_id", ForeignKey("lots.id"), primary_key=True),
    Column("serial", String(64), primary_key=True),
    Column("role", String(8), nullable=False),
    Column("added_at", UtcTime, nullable=False),
    CheckConstraint("role IN ('source', 'target')", name="role"),
    Index("ix_units_serial", "serial"),
)

recordings = Table(
    "recordings",
    metadata,
    sha256_column("sha256", primary_key=True),
    Column("lot_id", String(64), primary_key=True),
    Column("kind", String(8), primary_key=True),
    Column("serial", String(64), nullable=False),
    Column("samples", Integer, nullable=False),
    Column("sample_rate_Hz", Double, nullable=False),
    Column("output_unit", Text, nullable=False),
    Column("reference_unit", Text),
    sha256_column("blob_sha256", ForeignKey("blobs.sha256"), nullable=False),
    Column("added_at", UtcTime, nullable=False),
    ForeignKeyConstraint(["lot_id", "serial"], ["units.lot_id", "units.serial"]),
    CheckConstraint("kind IN ('source', 'unit', 'audit')", name="kind"),
    Index("ix_recordings_lot_id_serial", "lot_id", "serial"),
)

networks = Table(
    "networks",
    metadata,
    sha256_column("id", primary_key=True),
    Column("lot_id", ForeignKey("lots.id"), nullable=False),
    sha256_column("input_sha256", nullable=False, index=True),
    Column("settings", CanonicalJson, nullable=False),
    Column("training", CanonicalJson, nullable=False),
    Column("metrics", CanonicalJson, nullable=False),
    sha256_column("blob_sha256", ForeignKey("blobs.sha256"), nullable=False),
    Column("added_at", UtcTime, nullable=False),
)

calibrations = Table(
    "calibrations",
    metadata,
    Column("serial", String(64), primary_key=True),
    Column("revision", Integer, primary_key=True),
    Column("origin", String(32), primary_key=True),
    Column("lot_id", String(64), nullable=False),
    Column("made_at", UtcTime, nullable=False),
    Column("actor", Text, nullable=False),
    Column("reason", Text, nullable=False),
    Column("rolled_back_to", Integer),
    Column("network_id", ForeignKey("networks.id"), nullable=False),
    Column("family", Text, nullable=False),
    sha256_column("map_sha256", nullable=False),
    sha256_column("blob_sha256", ForeignKey("blobs.sha256"), nullable=False),
    Column("settings", CanonicalJson, nullable=False),
    Column("predicted_rmse", Double),
    Column("before_rmse", Double),
    Column("after_rmse", Double),
    Column("own_rmse", Double),
    Column("fit_s", Double),
    Column("verdict", String(16), nullable=False),
    Column("reasons", CanonicalJson, nullable=False),
    Column("evidence", CanonicalJson, nullable=False),
    sha256_column("input_sha256", nullable=False),
    sha256_column("recording_sha256", nullable=False),
    ForeignKeyConstraint(["lot_id", "serial"], ["units.lot_id", "units.serial"]),
    CheckConstraint("revision >= 1", name="revision"),
    CheckConstraint("verdict IN ('pass', 'conditional', 'fail', 'retest')", name="verdict"),
    Index("ix_calibrations_lot_id_serial", "lot_id", "serial", "made_at"),
    Index("ix_calibrations_serial_input", "serial", "input_sha256"),
)

refusals = Table(
    "refusals",
    metadata,
    Column("lot_id", String(64), primary_key=True),
    Column("serial", String(64), primary_key=True),
    Column("made_at", UtcTime, primary_key=True),
    Column("origin", String(32), primary_key=True),
    Column("actor", Text, nullable=False),
    Column("verdict", String(16), nullable=False),
    Column("reasons", CanonicalJson, nullable=False),
    sha256_column("work_sha256"),
    ForeignKeyConstraint(["lot_id", "serial"], ["units.lot_id", "units.serial"]),
    CheckConstraint("verdict IN ('fail', 'retest')", name="verdict"),
)

in_use = Table(
    "in_use",
    metadata,
    Column("lot_id", String(64), primary_key=True),
    Column("serial", String(64), primary_key=True),
    Column("origin", String(32), primary_key=True),
    Column("number", Integer, primary_key=True),
    Column("revision", Integer, nullable=False),
    Column("made_by", String(32), nullable=False),
    Column("follows_origin", String(32)),
    Column("follows_number", Integer),
    Column("decided_by", String(16), nullable=False),
    sha256_column("work_sha256"),
    sha256_column("input_sha256"),
    Column("made_at", UtcTime, nullable=False),
    Column("actor", Text, nullable=False),
    Column("reason", Text, nullable=False),
    ForeignKeyConstraint(["lot_id", "serial"], ["units.lot_id", "units.serial"]),
    ForeignKeyConstraint(
        ["serial", "revision", "made_by"], ["calibrations.serial", "calibrations.revision", "calibrations.origin"]
    ),
    CheckConstraint("number >= 1", name="number"),
    Index("ix_in_use_lot_id_serial", "lot_id", "serial", "made_at"),
    Index("ix_in_use_serial", "serial"),
)
"""Which calibration a unit of a lot uses, as statements: each names the one it follows. Two that nothing follows and
that name different maps are a conflict, which a person ends."""

audit = Table(
    "audit",
    metadata,
    Column("origin", String(32), primary_key=True),
    Column("seq", Integer, primary_key=True),
    Column("at", UtcTime, nullable=False),
    Column("actor", Text, nullable=False),
    Column("action", String(32), nullable=False),
    Column("entity", String(32), nullable=False),
    Column("key", Text, nullable=False),
    Column("before", Text),
    Column("after", Text),
    Column("reason", Text, nullable=False),
    sha256_column("prev_hash", nullable=False),
    sha256_column("hash", nullable=False),
    Index("ix_audit_entity_key", "entity", "key"),
)

work_items = Table(
    "work_items",
    metadata,
    Column("id", BigInteger().with_variant(Integer, "sqlite"), primary_key=True, autoincrement=True),
    Column("lot_id", String(64), nullable=False),
    Column("serial", String(64), nullable=False),
    Column("kind", String(32), nullable=False),
    sha256_column("work_set", nullable=False),
    sha256_column("input_sha256", nullable=False),
    Column("state", String(8), nullable=False),
    Column("attempts", Integer, nullable=False),
    Column("owner", Text),
    Column("lease_until", UtcTime),
    Column("changed_at", UtcTime, nullable=False),
    CheckConstraint("state IN ('queued', 'claimed', 'failed')", name="state"),
    Index("uq_work_items_item", "lot_id", "kind", "serial", "work_set", "input_sha256", unique=True),
    Index("ix_work_items_set_state", "lot_id", "kind", "work_set", "state", "id"),
    Index("ix_work_items_owner", "owner", "state"),
)

adaptations = Table(
    "adaptations",
    metadata,
    Column("serial", String(64), primary_key=True),
    Column("number", Integer, primary_key=True),
    Column("origin", String(32), primary_key=True),
    Column("revision", Integer, nullable=False),
    Column("stream", Text, nullable=False),
    Column("sample", Integer, nullable=False),
    Column("made_at", UtcTime, nullable=False),
    Column("entry", CanonicalJson, nullable=False),
    CheckConstraint("number >= 1", name="number"),
)

certificates = Table(
    "certificates",
    metadata,
    Column("cell_serial", String(64), primary_key=True),
    Column("issued_on", Date, primary_key=True),
    Column("origin", String(32), primary_key=True),
    Column("due_on", Date, nullable=False),
    Column("number", Text, nullable=False),
    Column("laboratory", Text, nullable=False),
    Column("capacity_N", Double, nullable=False),
    Column("uncertainty_N", Double, nullable=False),
    sha256_column("blob_sha256", ForeignKey("blobs.sha256")),
    Column("added_at", UtcTime, nullable=False),
    CheckConstraint("due_on > issued_on", name="due_on"),
)

golden_runs = Table(
    "golden_runs",
    metadata,
    Column("station", String(64), primary_key=True),
    Column("serial", String(64), primary_key=True),
    Column("made_at", UtcTime, primary_key=True),
    Column("origin", String(32), primary_key=True),
    Column("value", Double, nullable=False),
    Column("unit", Text, nullable=False),
    Column("passed", Boolean, nullable=False),
    Column("reasons", CanonicalJson, nullable=False),
    Column("actor", Text, nullable=False),
    sha256_column("recording_sha256"),
)

users = Table(
    "users",
    metadata,
    Column("name", String(64), primary_key=True),
    Column("role", String(16), nullable=False),
    Column("pin_hash", Text, nullable=False),
    Column("is_active", Boolean, nullable=False),
    Column("failures", Integer, nullable=False),
    Column("locked_until", UtcTime),
    Column("version", Integer, nullable=False),
    Column("changed_at", UtcTime, nullable=False),
    CheckConstraint("role IN ('operator', 'engineer', 'quality')", name="role"),
)

orders = Table(
    "orders",
    metadata,
    Column("order_id", String(64), primary_key=True),
    Column("station", String(64), nullable=False),
    Column("kind", String(16), nullable=False),
    Column("serial", String(64), nullable=False),
    Column("lot_id", String(64), nullable=False),
    Column("actor", Text, nullable=False),
    Column("reason", Text, nullable=False),
    Column("created", UtcTime, nullable=False),
    Column("state", String(16), nullable=False),
    Column("phase", Text, nullable=False),
    Column("fraction", Double, nullable=False),
    Column("remaining_s", Double, nullable=False),
    Column("code", Text, nullable=False),
    Column("message", Text, nullable=False),
    Column("recording_sha256", Text, nullable=False),
    Column("verdict", Text, nullable=False, server_default=""),
    Column("changed_at", UtcTime, nullable=False),
    CheckConstraint("state IN ('queued', 'running', 'done', 'error', 'cancelled')", name="state"),
    Index("ix_orders_station", "station", "created"),
)
Index("uq_orders_active", orders.c.station, unique=True)
# Of runs that are not over only. The migration says so: naming a dialect here loads both, a tenth of a second.

run_signals = Table(
    "run_signals",
    metadata,
    Column("order_id", ForeignKey("orders.order_id"), primary_key=True),
    Column("signal", CanonicalJson, nullable=False),
)

heartbeats = Table(
    "heartbeats",
    metadata,
    Column("station", String(64), primary_key=True),
    Column("state", String(16), nullable=False),
    Column("at", UtcTime, nullable=False),
    Column("reasons", CanonicalJson, nullable=False),
    Column("process", Text, nullable=False),
    Column("order_id", String(64), nullable=False),
    Column("gate", CanonicalJson, nullable=False, server_default="[]"),
    Column("is_overridden", Boolean, nullable=False, server_default=false()),
)

line_places = Table(
    "line_places",
    metadata,
    Column("station", String(64), primary_key=True),
    Column("version", Integer, nullable=False),
    Column("place", CanonicalJson, nullable=False),
)

network_releases = Table(
    "network_releases",
    metadata,
    Column("network_id", ForeignKey("networks.id"), primary_key=True),
    Column("made_at", UtcTime, primary_key=True),
    Column("origin", String(32), primary_key=True),
    Column("lot_id", ForeignKey("lots.id"), nullable=False),
    Column("state", String(16), nullable=False),
    Column("actor", Text, nullable=False),
    Column("reason", Text, nullable=False),
    CheckConstraint("state IN ('released', 'withdrawn')", name="state"),
)

jobs = Table(
    "jobs",
    metadata,
    Column("job_id", String(32), primary_key=True),
    Column("kind", String(32), nullable=False),
    Column("request", CanonicalJson, nullable=False),
    Column("actor", Text, nullable=False),
    Column("created", UtcTime, nullable=False),
    Column("state", String(16), nullable=False),
    Column("fraction", Double, nullable=False),
    Column("message", Text, nullable=False),
    Column("trace", CanonicalJson, nullable=False),
    Column("result", CanonicalJson, nullable=False),
    sha256_column("blob_sha256", ForeignKey("blobs.sha256")),
    Column("is_cancel_wanted", Boolean, nullable=False),
    Column("beaten_at", UtcTime, nullable=False),
    CheckConstraint("state IN ('queued', 'running', 'done', 'error', 'cancelled')", name="state"),
    Index("ix_jobs_kind", "kind", "created"),
)

tokens = Table(
    "tokens",
    metadata,
    Column("token_id", String(32), primary_key=True),
    sha256_column("sha256", nullable=False),
    Column("account", ForeignKey("users.name"), nullable=False),
    Column("purpose", Text, nullable=False),
    Column("created", UtcTime, nullable=False),
    Column("ends_at", UtcTime, nullable=False),
    Column("is_withdrawn", Boolean, nullable=False),
    Index("uq_tokens_sha256", "sha256", unique=True),
)

deliveries = Table(
    "deliveries",
    metadata,
    Column("destination", String(64), primary_key=True),
    Column("cursor", CanonicalJson, nullable=False),
    Column("delivered", BigInteger, nullable=False),
    Column("failures", Integer, nullable=False),
    Column("not_before", UtcTime),
    Column("error", Text, nullable=False),
    Column("changed_at", UtcTime, nullable=False),
    Column("holder", String(128)),
    Column("held_until", UtcTime),
)

AUDITED = (
    "lots",
    "limits",
    "line_rules",
    "units",
    "recordings",
    "networks",
    "network_releases",
    "calibrations",
    "refusals",
    "in_use",
    "adaptations",
    "certificates",
    "golden_runs",
)
"""Tables whose every row has a row in the audit trail with the same values, in the order their rows may be copied."""

LATER_COLUMNS = {"refusals": ("work_sha256",)}
"""Columns that rows of older schemas do not have: the audit trail of such a row does not name them."""

APPEND_ONLY = ("blobs", "audit", *AUDITED)
"""Tables whose rows are never changed or deleted; triggers on both databases see to it."""

TOLD_BY_HASH = {"adaptations": ("entry",)}
"""Columns that the audit trail holds as a SHA-256 only: thousands of rows a day would be kept twice."""
