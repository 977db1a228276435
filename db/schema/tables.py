"""The tables of the registry as after the step `SCHEMA` of `migrations/`."""

import json
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy import CheckConstraint, Column, Double, ForeignKey, Index, Integer, String, Table, Text
from sqlalchemy.types import TypeDecorator

from softcal.core.errors import RegistryError

SCHEMA = "0009"
"""Revision of the newest migration: what a registry must have to be used by this version."""

metadata = sa.MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "ck": "ck_%(table_name)s_%(constraint_name)s",
        "fk": "fk_%(table_name)s_%(column_0_N_name)s_%(referred_table_name)s",
        "pk": "pk_%(table_name)s",
    }
)


def _read_or_damaged(process: Any) -> Any:
    """Call the registry damaged where a value cannot be read: softcal never wrote it."""

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
    """An instant in UTC; a time without zone is refused. SQLite would drop the zone."""

    impl = sa.DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: sa.Dialect) -> datetime | None:
        if value is None:
            return None
        if value.tzinfo is None:
            raise ValueError(f"{value} has no time zone; give an instant in UTC")
        return value.astimezone(UTC)

    def process_result_value(self, value: datetime | None, dialect: sa.Dialect) -> datetime | None:
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)

    def result_processor(self, dialect: sa.Dialect, coltype: object) -> Any:
        return _read_or_damaged(_of_text(super().result_processor(dialect, coltype)))


def _of_text(process: Any) -> Any:
    """Refuse an instant in other words: SQLite would read it as the same and sort it as another."""

    def read(value: Any) -> Any:
        instant = process(value)
        if isinstance(value, str) and value != instant.strftime("%Y-%m-%d %H:%M:%S.%f"):
            raise ValueError(value)
        return instant

    return read


class CanonicalJson(TypeDecorator[Any]):
    """JSON as text with sorted keys: equal values, equal bytes on every database. NaN is refused."""

    impl = Text
    cache_ok = True

    def process_bind_param(self, value: Any, dialect: sa.Dialect) -> str | None:
        return None if value is None else canonical_json(value)

    def process_result_value(self, value: str | None, dialect: sa.Dialect) -> Any:
        return None if value is None else json.loads(value)

    def result_processor(self, dialect: sa.Dialect, coltype: object) -> Any:
        return _read_or_damaged(super().result_processor(dialect, coltype))


ENCODER = json.JSONEncoder(sort_keys=True, separators=(",", ":"), allow_nan=False)


def canonical_json(value: object) -> str:
    """Return JSON text that is the same for equal values."""
    return ENCODER.encode(value)


SHA256 = String(64)
"""A content hash in hex."""


def keys(kind: Any, *names: str) -> list[Column[Any]]:
    """Return columns of the primary key."""
    return [Column(name, kind, primary_key=True) for name in names]


def needed(kind: Any, *names: str) -> list[Column[Any]]:
    return [Column(name, kind, nullable=False) for name in names]


def optional(kind: Any, *names: str) -> list[Column[Any]]:
    return [Column(name, kind) for name in names]


registry_info = Table("registry_info", metadata, *keys(String(64), "key"), *needed(Text, "value"))

blobs = Table(
    "blobs",
    metadata,
    *keys(SHA256, "sha256"),
    *needed(String(16), "kind"),
    *needed(Integer, "size"),
    *needed(sa.LargeBinary, "data"),
)

lots = Table(
    "lots",
    metadata,
    *keys(String(64), "id"),
    *needed(String(64), "source"),
    *needed(Double, "sample_rate_Hz"),
    *needed(Text, "sensor_model", "reference_quantity", "reference_unit", "output_unit"),
    *needed(UtcTime, "added_at"),
)

limits = Table(
    "limits",
    metadata,
    Column("lot_id", ForeignKey("lots.id"), primary_key=True),
    *keys(Integer, "version"),
    *keys(String(32), "origin"),
    Column("rmse", Double),
    *needed(UtcTime, "made_at"),
    *needed(Text, "actor", "reason"),
    CheckConstraint("version >= 1", name="version"),
)

line_rules = Table(
    "line_rules",
    metadata,
    Column("lot_id", ForeignKey("lots.id"), primary_key=True),
    *keys(Integer, "version"),
    *keys(String(32), "origin"),
    *needed(CanonicalJson, "rules"),
    *needed(UtcTime, "made_at"),
    *needed(Text, "actor", "reason"),
    CheckConstraint("version >= 1", name="version"),
)

units = Table(
    "units",
    metadata,
    Column("lot_id", ForeignKey("lots.id"), primary_key=True),
    *keys(String(64), "serial"),
    *needed(String(8), "role"),
    *needed(UtcTime, "added_at"),
    CheckConstraint("role IN ('source', 'target')", name="role"),
    Index("ix_units_serial", "serial"),
)

recordings = Table(
    "recordings",
    metadata,
    *keys(SHA256, "sha256"),
    *keys(String(64), "lot_id"),
    *keys(String(8), "kind"),
    *needed(String(64), "serial"),
    *needed(Integer, "samples"),
    *needed(Double, "sample_rate_Hz"),
    *needed(Text, "output_unit"),
    Column("reference_unit", Text),
    Column("blob_sha256", SHA256, ForeignKey("blobs.sha256"), nullable=False),
    *needed(UtcTime, "added_at"),
    sa.ForeignKeyConstraint(["lot_id", "serial"], ["units.lot_id", "units.serial"]),
    CheckConstraint("kind IN ('source', 'unit', 'audit')", name="kind"),
    Index("ix_recordings_lot_id_serial", "lot_id", "serial"),
)

networks = Table(
    "networks",
    metadata,
    *keys(SHA256, "id"),
    Column("lot_id", ForeignKey("lots.id"), nullable=False),
    Column("input_sha256", SHA256, nullable=False, index=True),
    *needed(CanonicalJson, "settings", "training", "metrics"),
    Column("blob_sha256", SHA256, ForeignKey("blobs.sha256"), nullable=False),
    *needed(UtcTime, "added_at"),
)

calibrations = Table(
    "calibrations",
    metadata,
    *keys(String(64), "serial"),
    *keys(Integer, "revision"),
    *keys(String(32), "origin"),
    *needed(String(64), "lot_id"),
    *needed(UtcTime, "made_at"),
    *needed(Text, "actor", "reason"),
    Column("rolled_back_to", Integer),
    Column("network_id", ForeignKey("networks.id"), nullable=False),
    *needed(Text, "family"),
    *needed(SHA256, "map_sha256"),
    Column("blob_sha256", SHA256, ForeignKey("blobs.sha256"), nullable=False),
    *needed(CanonicalJson, "settings"),
    *optional(Double, "predicted_rmse", "before_rmse", "after_rmse", "own_rmse", "fit_s"),
    *needed(String(16), "verdict"),
    *needed(CanonicalJson, "reasons", "evidence"),
    *needed(SHA256, "input_sha256", "recording_sha256"),
    sa.ForeignKeyConstraint(["lot_id", "serial"], ["units.lot_id", "units.serial"]),
    CheckConstraint("revision >= 1", name="revision"),
    CheckConstraint("verdict IN ('pass', 'conditional', 'fail', 'retest')", name="verdict"),
    Index("ix_calibrations_lot_id_serial", "lot_id", "serial", "made_at"),
    Index("ix_calibrations_serial_input", "serial", "input_sha256"),
)

refusals = Table(
    "refusals",
    metadata,
    *keys(String(64), "lot_id", "serial"),
    *keys(UtcTime, "made_at"),
    *keys(String(32), "origin"),
    *needed(Text, "actor"),
    *needed(String(16), "verdict"),
    *needed(CanonicalJson, "reasons"),
    Column("work_sha256", SHA256),
    sa.ForeignKeyConstraint(["lot_id", "serial"], ["units.lot_id", "units.serial"]),
    CheckConstraint("verdict IN ('fail', 'retest')", name="verdict"),
)

in_use = Table(
    "in_use",
    metadata,
    *keys(String(64), "lot_id", "serial"),
    *keys(String(32), "origin"),
    *keys(Integer, "number"),
    *needed(Integer, "revision"),
    *needed(String(32), "made_by"),
    Column("follows_origin", String(32)),
    Column("follows_number", Integer),
    *needed(String(16), "decided_by"),
    Column("work_sha256", SHA256),
    Column("input_sha256", SHA256),
    *needed(UtcTime, "made_at"),
    *needed(Text, "actor", "reason"),
    sa.ForeignKeyConstraint(["lot_id", "serial"], ["units.lot_id", "units.serial"]),
    sa.ForeignKeyConstraint(
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
    *keys(String(32), "origin"),
    *keys(Integer, "seq"),
    *needed(UtcTime, "at"),
    *needed(Text, "actor"),
    *needed(String(32), "action", "entity"),
    *needed(Text, "key"),
    *optional(Text, "before", "after"),
    *needed(Text, "reason"),
    *needed(SHA256, "prev_hash", "hash"),
    Index("ix_audit_entity_key", "entity", "key"),
)

work_items = Table(
    "work_items",
    metadata,
    Column("id", sa.BigInteger().with_variant(Integer, "sqlite"), primary_key=True, autoincrement=True),
    *needed(String(64), "lot_id", "serial"),
    *needed(String(32), "kind"),
    *needed(SHA256, "work_set", "input_sha256"),
    *needed(String(8), "state"),
    *needed(Integer, "attempts"),
    Column("owner", Text),
    Column("lease_until", UtcTime),
    *needed(UtcTime, "changed_at"),
    CheckConstraint("state IN ('queued', 'claimed', 'failed')", name="state"),
    Index("uq_work_items_item", "lot_id", "kind", "serial", "work_set", "input_sha256", unique=True),
    Index("ix_work_items_set_state", "lot_id", "kind", "work_set", "state", "id"),
    Index("ix_work_items_owner", "owner", "state"),
)

adaptations = Table(
    "adaptations",
    metadata,
    *keys(String(64), "serial"),
    *keys(Integer, "number"),
    *keys(String(32), "origin"),
    *needed(Integer, "revision"),
    *needed(Text, "stream"),
    *needed(Integer, "sample"),
    *needed(UtcTime, "made_at"),
    *needed(CanonicalJson, "entry"),
    CheckConstraint("number >= 1", name="number"),
)

certificates = Table(
    "certificates",
    metadata,
    *keys(String(64), "cell_serial"),
    *keys(sa.Date, "issued_on"),
    *keys(String(32), "origin"),
    *needed(sa.Date, "due_on"),
    *needed(Text, "number", "laboratory"),
    *needed(Double, "capacity_N", "uncertainty_N"),
    Column("blob_sha256", SHA256, ForeignKey("blobs.sha256")),
    *needed(UtcTime, "added_at"),
    CheckConstraint("due_on > issued_on", name="due_on"),
)

golden_runs = Table(
    "golden_runs",
    metadata,
    *keys(String(64), "station", "serial"),
    *keys(UtcTime, "made_at"),
    *keys(String(32), "origin"),
    *needed(Double, "value"),
    *needed(Text, "unit"),
    *needed(sa.Boolean, "passed"),
    *needed(CanonicalJson, "reasons"),
    *needed(Text, "actor"),
    Column("recording_sha256", SHA256),
)

users = Table(
    "users",
    metadata,
    *keys(String(64), "name"),
    *needed(String(16), "role"),
    *needed(Text, "pin_hash"),
    *needed(sa.Boolean, "is_active"),
    *needed(Integer, "failures"),
    Column("locked_until", UtcTime),
    *needed(Integer, "version"),
    *needed(UtcTime, "changed_at"),
    CheckConstraint("role IN ('operator', 'engineer', 'quality')", name="role"),
)

orders = Table(
    "orders",
    metadata,
    *keys(String(64), "order_id"),
    *needed(String(64), "station"),
    *needed(String(16), "kind"),
    *needed(String(64), "serial", "lot_id"),
    *needed(Text, "actor", "reason"),
    *needed(UtcTime, "created"),
    *needed(String(16), "state"),
    *needed(Text, "phase"),
    *needed(Double, "fraction", "remaining_s"),
    *needed(Text, "code", "message", "recording_sha256"),
    Column("verdict", Text, nullable=False, server_default=""),
    *needed(UtcTime, "changed_at"),
    CheckConstraint("state IN ('queued', 'running', 'done', 'error', 'cancelled')", name="state"),
    Index("ix_orders_station", "station", "created"),
)
Index("uq_orders_active", orders.c.station, unique=True)
# Of runs that are not over, as the migration says: naming a dialect here would load both.

run_signals = Table(
    "run_signals",
    metadata,
    Column("order_id", ForeignKey("orders.order_id"), primary_key=True),
    *needed(CanonicalJson, "signal"),
)

heartbeats = Table(
    "heartbeats",
    metadata,
    *keys(String(64), "station"),
    *needed(String(16), "state"),
    *needed(UtcTime, "at"),
    *needed(CanonicalJson, "reasons"),
    *needed(Text, "process"),
    *needed(String(64), "order_id"),
    Column("gate", CanonicalJson, nullable=False, server_default="[]"),
    Column("is_overridden", sa.Boolean, nullable=False, server_default=sa.false()),
)

line_places = Table(
    "line_places", metadata, *keys(String(64), "station"), *needed(Integer, "version"), *needed(CanonicalJson, "place")
)

network_releases = Table(
    "network_releases",
    metadata,
    Column("network_id", ForeignKey("networks.id"), primary_key=True),
    *keys(UtcTime, "made_at"),
    *keys(String(32), "origin"),
    Column("lot_id", ForeignKey("lots.id"), nullable=False),
    *needed(String(16), "state"),
    *needed(Text, "actor", "reason"),
    CheckConstraint("state IN ('released', 'withdrawn')", name="state"),
)

jobs = Table(
    "jobs",
    metadata,
    *keys(String(32), "job_id"),
    *needed(String(32), "kind"),
    *needed(CanonicalJson, "request"),
    *needed(Text, "actor"),
    *needed(UtcTime, "created"),
    *needed(String(16), "state"),
    *needed(Double, "fraction"),
    *needed(Text, "message"),
    *needed(CanonicalJson, "trace", "result"),
    Column("blob_sha256", SHA256, ForeignKey("blobs.sha256")),
    *needed(sa.Boolean, "is_cancel_wanted"),
    *needed(UtcTime, "beaten_at"),
    CheckConstraint("state IN ('queued', 'running', 'done', 'error', 'cancelled')", name="state"),
    Index("ix_jobs_kind", "kind", "created"),
)

tokens = Table(
    "tokens",
    metadata,
    *keys(String(32), "token_id"),
    *needed(SHA256, "sha256"),
    Column("account", ForeignKey("users.name"), nullable=False),
    *needed(Text, "purpose"),
    *needed(UtcTime, "created", "ends_at"),
    *needed(sa.Boolean, "is_withdrawn"),
    Index("uq_tokens_sha256", "sha256", unique=True),
)

deliveries = Table(
    "deliveries",
    metadata,
    *keys(String(64), "destination"),
    *needed(CanonicalJson, "cursor"),
    *needed(sa.BigInteger, "delivered"),
    *needed(Integer, "failures"),
    Column("not_before", UtcTime),
    *needed(Text, "error"),
    *needed(UtcTime, "changed_at"),
    Column("holder", String(128)),
    Column("held_until", UtcTime),
)

AUDITED = tuple(
    "lots limits line_rules units recordings networks network_releases calibrations refusals in_use adaptations "
    "certificates golden_runs".split()
)
"""Tables whose every row stands in the audit trail, too, in the order rows may be copied."""

LATER_COLUMNS = {"refusals": ("work_sha256",)}
"""Columns that older schemas did not have: the audit trail of their rows names none."""

APPEND_ONLY = ("blobs", "audit", *AUDITED)
"""Tables whose rows are never changed or deleted; triggers on both databases see to it."""

TOLD_BY_HASH = {"adaptations": ("entry",)}
"""Columns of which the audit trail holds a SHA-256 only, as there are thousands of rows a day."""
