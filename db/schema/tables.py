"""The tables of the registry. Their history is in `migrations/`; `SCHEMA` names the step these definitions equal."""

import json
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import (
    Boolean,
    CheckConstraint,
    Column,
    DateTime,
    Dialect,
    ForeignKeyConstraint,
    Index,
    MetaData,
    Table,
    Text,
    false,
)
from sqlalchemy.schema import SchemaItem
from sqlalchemy.types import TypeDecorator

from softcal.core.errors import RegistryError
from softcal.db.schema.columns import PLAIN, columns

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


STORED = {**PLAIN, "time": UtcTime(), "json": CanonicalJson()}


def _table(name: str, page: str, *rest: SchemaItem) -> Table:
    return Table(name, metadata, *columns(page, STORED), *rest)


registry_info = _table("registry_info", "key 64*, value text")

blobs = _table("blobs", "sha256 64*, kind 16, size int, data bytes")

lots = _table(
    "lots",
    "id 64*, source 64, sample_rate_Hz double, sensor_model text, reference_quantity text, "
    "reference_unit text, output_unit text, added_at time",
)

limits = _table(
    "limits",
    "lot_id 64*>lots.id, version int*, origin 32*, rmse double?, made_at time, actor text, reason text",
    CheckConstraint("version >= 1", name="version"),
)

line_rules = _table(
    "line_rules",
    "lot_id 64*>lots.id, version int*, origin 32*, rules json, made_at time, actor text, reason text",
    CheckConstraint("version >= 1", name="version"),
)

units = _table(
    "units",
    "lot_id 64*>lots.id, serial 64*, role 8, added_at time",
    CheckConstraint("role IN ('source', 'target')", name="role"),
    Index("ix_units_serial", "serial"),
)

recordings = _table(
    "recordings",
    "sha256 64*, lot_id 64*, kind 8*, serial 64, samples int, sample_rate_Hz double, "
    "output_unit text, reference_unit text?, blob_sha256 64>blobs.sha256, added_at time",
    ForeignKeyConstraint(["lot_id", "serial"], ["units.lot_id", "units.serial"]),
    CheckConstraint("kind IN ('source', 'unit', 'audit')", name="kind"),
    Index("ix_recordings_lot_id_serial", "lot_id", "serial"),
)

networks = _table(
    "networks",
    "id 64*, lot_id 64>lots.id, input_sha256 64, settings json, training json, metrics json, "
    "blob_sha256 64>blobs.sha256, added_at time",
    Index("ix_networks_input_sha256", "input_sha256"),
)

calibrations = _table(
    "calibrations",
    "serial 64*, revision int*, origin 32*, lot_id 64, made_at time, actor text, reason text, "
    "rolled_back_to int?, network_id 64>networks.id, family text, map_sha256 64, "
    "blob_sha256 64>blobs.sha256, settings json, predicted_rmse double?, before_rmse double?, "
    "after_rmse double?, own_rmse double?, fit_s double?, verdict 16, reasons json, "
    "evidence json, input_sha256 64, recording_sha256 64",
    ForeignKeyConstraint(["lot_id", "serial"], ["units.lot_id", "units.serial"]),
    CheckConstraint("revision >= 1", name="revision"),
    CheckConstraint("verdict IN ('pass', 'conditional', 'fail', 'retest')", name="verdict"),
    Index("ix_calibrations_lot_id_serial", "lot_id", "serial", "made_at"),
    Index("ix_calibrations_serial_input", "serial", "input_sha256"),
)

refusals = _table(
    "refusals",
    "lot_id 64*, serial 64*, made_at time*, origin 32*, actor text, verdict 16, reasons json, work_sha256 64?",
    ForeignKeyConstraint(["lot_id", "serial"], ["units.lot_id", "units.serial"]),
    CheckConstraint("verdict IN ('fail', 'retest')", name="verdict"),
)

in_use = _table(
    "in_use",
    "lot_id 64*, serial 64*, origin 32*, number int*, revision int, made_by 32, "
    "follows_origin 32?, follows_number int?, decided_by 16, work_sha256 64?, input_sha256 64?, "
    "made_at time, actor text, reason text",
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

audit = _table(
    "audit",
    "origin 32*, seq int*, at time, actor text, action 32, entity 32, key text, before text?, "
    "after text?, reason text, prev_hash 64, hash 64",
    Index("ix_audit_entity_key", "entity", "key"),
)

work_items = _table(
    "work_items",
    "id number*, lot_id 64, serial 64, kind 32, work_set 64, input_sha256 64, state 8, "
    "attempts int, owner text?, lease_until time?, changed_at time",
    CheckConstraint("state IN ('queued', 'claimed', 'failed')", name="state"),
    Index("uq_work_items_item", "lot_id", "kind", "serial", "work_set", "input_sha256", unique=True),
    Index("ix_work_items_set_state", "lot_id", "kind", "work_set", "state", "id"),
    Index("ix_work_items_owner", "owner", "state"),
)

adaptations = _table(
    "adaptations",
    "serial 64*, number int*, origin 32*, revision int, stream text, sample int, made_at time, entry json",
    CheckConstraint("number >= 1", name="number"),
)

certificates = _table(
    "certificates",
    "cell_serial 64*, issued_on date*, origin 32*, due_on date, number text, laboratory text, "
    "capacity_N double, uncertainty_N double, blob_sha256 64?>blobs.sha256, added_at time",
    CheckConstraint("due_on > issued_on", name="due_on"),
)

golden_runs = _table(
    "golden_runs",
    "station 64*, serial 64*, made_at time*, origin 32*, value double, unit text, passed bool, "
    "reasons json, actor text, recording_sha256 64?",
)

users = _table(
    "users",
    "name 64*, role 16, pin_hash text, is_active bool, failures int, locked_until time?, version int, changed_at time",
    CheckConstraint("role IN ('operator', 'engineer', 'quality')", name="role"),
)

orders = _table(
    "orders",
    "order_id 64*, station 64, kind 16, serial 64, lot_id 64, actor text, reason text, "
    "created time, state 16, phase text, fraction double, remaining_s double, code text, "
    "message text, recording_sha256 text",
    Column("verdict", Text, nullable=False, server_default=""),
    *columns("changed_at time", STORED),
    CheckConstraint("state IN ('queued', 'running', 'done', 'error', 'cancelled')", name="state"),
    Index("ix_orders_station", "station", "created"),
)
Index("uq_orders_active", orders.c.station, unique=True)
# Of runs that are not over only. The migration says so: naming a dialect here loads both, a tenth of a second.

run_signals = _table("run_signals", "order_id 64*>orders.order_id, signal json")

heartbeats = _table(
    "heartbeats",
    "station 64*, state 16, at time, reasons json, process text, order_id 64",
    Column("gate", CanonicalJson, nullable=False, server_default="[]"),
    Column("is_overridden", Boolean, nullable=False, server_default=false()),
)

line_places = _table("line_places", "station 64*, version int, place json")

network_releases = _table(
    "network_releases",
    "network_id 64*>networks.id, made_at time*, origin 32*, lot_id 64>lots.id, state 16, actor text, reason text",
    CheckConstraint("state IN ('released', 'withdrawn')", name="state"),
)

jobs = _table(
    "jobs",
    "job_id 32*, kind 32, request json, actor text, created time, state 16, fraction double, "
    "message text, trace json, result json, blob_sha256 64?>blobs.sha256, is_cancel_wanted bool, "
    "beaten_at time",
    CheckConstraint("state IN ('queued', 'running', 'done', 'error', 'cancelled')", name="state"),
    Index("ix_jobs_kind", "kind", "created"),
)

tokens = _table(
    "tokens",
    "token_id 32*, sha256 64, account 64>users.name, purpose text, created time, ends_at time, is_withdrawn bool",
    Index("uq_tokens_sha256", "sha256", unique=True),
)

deliveries = _table(
    "deliveries",
    "destination 64*, cursor json, delivered big, failures int, not_before time?, error text, "
    "changed_at time, holder 128?, held_until time?",
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
