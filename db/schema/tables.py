"""The tables of the registry."""

from collections.abc import Sequence
from itertools import chain
from typing import Any

import sqlalchemy as sa
from sqlalchemy import CheckConstraint, Column, Double, ForeignKey, Index, Integer, String, Table, Text

from softcal.db.schema.column_types import CanonicalJson, UtcTime

SCHEMA = "1"
"""Revision of the newest migration, which a registry must have to be used by this version."""

metadata = sa.MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "ck": "ck_%(table_name)s_%(constraint_name)s",
        "fk": "fk_%(table_name)s_%(column_0_N_name)s_%(referred_table_name)s",
        "pk": "pk_%(table_name)s",
    }
)


SHA256 = NAME = String(64)
"""A content hash in hex; a serial or an id that people give."""

ORIGIN = String(32)
"""Name of the registry that wrote a row."""


def table(name: str, *parts: Any) -> Table:
    """Return a table of this registry."""
    return Table(name, metadata, *parts)


def keys(**kinds: Any) -> list[Column[Any]]:
    """Return columns of the primary key."""
    return [Column(name, kind, primary_key=True) for name, kind in kinds.items()]


def required(**kinds: Any) -> list[Column[Any]]:
    """Return columns that every row fills."""
    return [Column(name, kind, nullable=False) for name, kind in kinds.items()]


def optional(**kinds: Any) -> list[Column[Any]]:
    """Return columns that a row may leave empty."""
    return [Column(name, kind) for name, kind in kinds.items()]


OF_LOT: dict[str, Any] = {"lot_id": NAME}
OF_UNIT = OF_LOT | {"serial": NAME}
OF_RECORDING = OF_UNIT | {"recording_sha256": SHA256}


def declaration_table(name: str, key: dict[str, Any], *values: Sequence[Column[Any]]) -> Table:
    """Return a table of declarations under a key: the newest row is in force."""
    write_columns = (*keys(**key, made_at=UtcTime, origin=ORIGIN), *required(actor=Text, reason=Text))
    lot = (sa.ForeignKeyConstraint(["lot_id"], ["lots.id"]),) if next(iter(key)) == "lot_id" else ()
    return table(name, *write_columns, *chain.from_iterable(values), *lot)


def listed(parent: Table, name: str, key: dict[str, Any], *values: Sequence[Column[Any]]) -> Table:
    """Return a table of what one declaration lists, under its key and one of their own."""
    above = {column.name: column.type for column in parent.primary_key}
    parent_columns = [f"{parent.name}.{column}" for column in above]
    return table(name, *keys(**above, **key), *chain(*values), sa.ForeignKeyConstraint([*above], parent_columns))


def numbered_table(name: str, number: str, *values: Sequence[Column[Any]]) -> Table:
    """Return a table of what is set or decided of lots, 1, 2, 3 ... each, by whichever registry."""
    key = [Column("lot_id", ForeignKey("lots.id"), primary_key=True), *keys(**{number: Integer, "origin": ORIGIN})]
    write_columns = required(made_at=UtcTime, actor=Text, reason=Text)
    return table(name, *key, *chain(*values), *write_columns, CheckConstraint(f"{number} >= 1", name=number))


registry_info = table("registry_info", *keys(key=NAME), *required(value=Text))

blobs = Table("blobs", metadata, *keys(sha256=SHA256), *required(kind=String(16), size=Integer, data=sa.LargeBinary))

lots = table(
    "lots",
    *keys(id=NAME),
    *required(source=NAME, sample_rate_Hz=Double, sensor_model=Text, reference_quantity=Text),
    *required(reference_unit=Text, output_unit=Text, added_at=UtcTime),
)

limits = numbered_table("limits", "version", optional(rmse=Double))
line_rules = numbered_table(
    "line_rules",
    "version",
    required(serial_pattern=Text, letters=String(16), is_badge_needed=sa.Boolean),
    optional(target=Integer, retests_pass=Integer, retests_conditional=Integer, retests_fail=Integer),
    optional(retests_retest=Integer, load_1=Double, load_1_expanded=Double, load_2=Double, load_2_expanded=Double),
)

units = table(
    "units",
    Column("lot_id", ForeignKey("lots.id"), primary_key=True),
    *keys(serial=NAME),
    *required(role=String(8), added_at=UtcTime),
    CheckConstraint("role IN ('source', 'target')", name="role"),
    Index("ix_units_serial", "serial"),
)

recordings = table(
    "recordings",
    *keys(sha256=SHA256, lot_id=NAME, kind=String(8)),
    *required(serial=NAME, samples=Integer, sample_rate_Hz=Double, output_unit=Text),
    *required(output_sha256=SHA256),
    *optional(reference_unit=Text, measured_at=UtcTime, proof_method=SHA256),
    Column("blob_sha256", SHA256, ForeignKey("blobs.sha256"), nullable=False),
    *required(added_at=UtcTime),
    sa.ForeignKeyConstraint(["lot_id", "serial"], ["units.lot_id", "units.serial"]),
    CheckConstraint("kind IN ('source', 'unit', 'audit')", name="kind"),
    Index("ix_recordings_lot_id_serial", "lot_id", "serial"),
    Index("ix_recordings_output_sha256", "output_sha256"),
)

networks = table(
    "networks",
    *keys(id=SHA256),
    Column("lot_id", ForeignKey("lots.id"), nullable=False),
    Column("input_sha256", SHA256, nullable=False, index=True),
    *required(settings=CanonicalJson, training=CanonicalJson, metrics=CanonicalJson),
    Column("blob_sha256", SHA256, ForeignKey("blobs.sha256"), nullable=False),
    *required(added_at=UtcTime),
)

methods = table("methods", *keys(id=SHA256), *required(numbers=CanonicalJson))
"""Every number that units were calibrated with, once for all units of a method."""

fits = table(
    "fits",
    *keys(lot_id=NAME, sha256=SHA256),
    *required(serial=NAME),
    Column("network_id", ForeignKey("networks.id"), nullable=False),
    Column("method_id", ForeignKey("methods.id"), nullable=False),
    *required(recording_sha256=SHA256, content=CanonicalJson),
    Column("blob_sha256", SHA256, ForeignKey("blobs.sha256"), nullable=False),
    sa.ForeignKeyConstraint(["lot_id", "serial"], ["units.lot_id", "units.serial"]),
)
"""What recordings gave, by the hash of their content: no act changes a fit."""


def part_of_states(name: str, *values: Sequence[Column[Any]]) -> Table:
    """Return a table of one part of units' states, by the hash of its content; a nested value has its name before."""
    lot: Column[Any] = Column("lot_id", ForeignKey("lots.id"), primary_key=True)
    return table(name, lot, *keys(sha256=SHA256), *chain.from_iterable(values))


trims = part_of_states(
    "trims",
    required(output=CanonicalJson, reference=CanonicalJson, recording_sha256=SHA256, audit_sha256=SHA256),
    required(gain=Double, offset=Double, covariance=CanonicalJson, before_rmse=Double, after_rmse=Double),
    required(is_blocking=sa.Boolean),
    optional(left_out=CanonicalJson),
)
corrections = part_of_states(
    "corrections",
    required(number=Integer, line_gain=Double, line_zero=Double, gain_error=Double, zero_error=Double),
    required(audits=Integer, gain=Double, offset=Double),
)
sample_releases = part_of_states(
    "sample_releases",
    required(number=Integer, limit_rmse=Double, is_released=sa.Boolean, scale=Double),
    required(interval_inflation_scale=Double, interval_inflation_added=Double, day_rmse=Double, audits=CanonicalJson),
    required(risk=Double, confidence=Double, sitting=Text),
    optional(factor=Double, withdrawn=CanonicalJson),
)
audits = part_of_states(
    "audits",
    required(map_id=SHA256, recording_sha256=SHA256, output_sha256=SHA256),
    required(
        scores_before_rmse=Double, scores_before_rows=Integer, scores_after_rmse=Double, scores_after_rows=Integer
    ),
    optional(scores_own_before_rmse=Double, scores_own_before_rows=Integer, scores_own_after_rmse=Double),
    optional(scores_own_after_rows=Integer, scores_own_own_rmse=Double, scores_own_own_rows=Integer),
    required(scores_unscored=CanonicalJson, line_gain=Double, line_zero=Double),
    required(fitted_line_gain=Double, fitted_line_zero=Double, unit_rest=Double, audit_rest=Double, span=Double),
    required(residual=CanonicalJson, half=CanonicalJson),
)
STATE_PARTS = {"trim": trims, "correction": corrections, "release": sample_releases, "audit": audits}
"""What was done to units and what audits showed, by the field of a state. Arrays stand encoded in one column: nothing
asks for one of their numbers."""

calibrations = table(
    "calibrations",
    *keys(serial=NAME, revision=Integer, origin=ORIGIN),
    *required(lot_id=NAME, made_at=UtcTime, actor=Text, reason=Text, version=Text, build=Text),
    *optional(rolled_back_to=Integer),
    *required(fit_sha256=SHA256, network_id=SHA256, method_id=SHA256, family=Text, map_sha256=SHA256),
    *required(state_sha256=SHA256),
    *optional(**{f"{name}_sha256": SHA256 for name in STATE_PARTS}),
    *optional(predicted_rmse=Double, before_rmse=Double, after_rmse=Double, own_rmse=Double, fit_s=Double),
    *required(limit_unit=Text, limit_rmse=Double, limit_origin=CanonicalJson, is_limit_stated=sa.Boolean),
    *optional(limit_reference_expanded=Double, limit_full_range=Double),
    *optional(unreadable_audit=CanonicalJson, suspect_audit=CanonicalJson),
    *required(verdict=String(16), reasons=CanonicalJson, input_sha256=SHA256, recording_sha256=SHA256),
    sa.ForeignKeyConstraint(["lot_id", "serial"], ["units.lot_id", "units.serial"]),
    sa.ForeignKeyConstraint(["lot_id", "fit_sha256"], ["fits.lot_id", "fits.sha256"]),
    *(
        sa.ForeignKeyConstraint(["lot_id", f"{name}_sha256"], [f"{part.name}.lot_id", f"{part.name}.sha256"])
        for name, part in STATE_PARTS.items()
    ),
    CheckConstraint("revision >= 1", name="revision"),
    CheckConstraint("verdict IN ('pass', 'conditional', 'fail', 'retest')", name="verdict"),
    Index("ix_calibrations_lot_id_serial", "lot_id", "serial", "made_at"),
    Index("ix_calibrations_serial_input", "serial", "input_sha256"),
)

refusals = table(
    "refusals",
    *keys(lot_id=NAME, serial=NAME, made_at=UtcTime, origin=ORIGIN),
    *required(actor=Text, verdict=String(16), reasons=CanonicalJson),
    *optional(work_sha256=SHA256),
    sa.ForeignKeyConstraint(["lot_id", "serial"], ["units.lot_id", "units.serial"]),
    CheckConstraint("verdict IN ('fail', 'retest')", name="verdict"),
)

lot_decisions = numbered_table("lot_decisions", "number", required(version=Text, build=Text, decision=CanonicalJson))
"""What was decided on a lot as a whole: its correction, and the statement on the units that nobody measured."""

declaration_table("line_spreads", OF_LOT, optional(load=Double, day=Double))
declaration_table("map_families", OF_LOT, required(family=Text))
lot_sources = declaration_table("lot_sources", OF_LOT)
source_networks = listed(lot_sources, "source_networks", {"position": Integer}, required(network_id=SHA256))
declaration_table(
    "lot_references",
    OF_LOT,
    required(cell=Text, certificate=Text, laboratory=Text, is_simulated=sa.Boolean, coverage_factor=Double),
    optional(issued_on=sa.Date, due_on=sa.Date, used_on=sa.Date, uncertainty=Double, capacity=Double, drift=Double),
    optional(temperature_per_K=Double, temperature_K=Double, contact=Double, repeatability=Double, bandwidth=Double),
    required(source_rms=Double),
)
known_loads = declaration_table("known_loads", OF_RECORDING, required(brought_by=String(8)))
load_readings = listed(known_loads, "load_readings", {"position": Integer}, required(output=Double, reference=Double))
declaration_table("unit_golden_runs", OF_RECORDING, required(golden_sha256=SHA256))
declaration_table(
    "exports",
    OF_UNIT | {"host": Text, "place": Text},
    required(revision=Integer, map_sha256=SHA256, verdict=String(16)),
)
declaration_table("confirmed_audits", OF_UNIT, required(output_sha256=SHA256, doubt=CanonicalJson))
lot_statements = declaration_table(
    "lot_statements",
    OF_LOT,
    required(word=String(16), nonconforming_upper=Integer, process_upper=Double, error_ratio=Double, text=Text),
)
checked_units = listed(
    lot_statements, "checked_units", {"serial": NAME}, required(measured_rmse=Double, is_failed=sa.Boolean)
)
declaration_table("laboratories", {"section": NAME}, required(statements=CanonicalJson))
declaration_table(
    "station_qualifications", {"station": NAME}, required(is_passed=sa.Boolean, due_on=sa.Date, page=CanonicalJson)
)
declaration_table(
    "alerts", {"kind": String(32), "lot_id": NAME, "about": NAME}, required(is_open=sa.Boolean, content=CanonicalJson)
)

LISTS = {"lot_sources": source_networks, "known_loads": load_readings, "lot_statements": checked_units}
"""Tables of what declarations list, by the table of the declarations."""

draws = declaration_table(
    "draws",
    OF_LOT,
    required(population=Integer, allowed_share=Double, seed=Integer),
)
drawn_units = table(
    "drawn_units",
    *keys(lot_id=NAME, made_at=UtcTime, origin=ORIGIN, serial=NAME),
    *required(is_random=sa.Boolean, predicted_rmse=Double),
    sa.ForeignKeyConstraint(["lot_id", "made_at", "origin"], ["draws.lot_id", "draws.made_at", "draws.origin"]),
)

in_use = table(
    "in_use",
    *keys(lot_id=NAME, serial=NAME, origin=ORIGIN, number=Integer),
    *required(revision=Integer, made_by=ORIGIN),
    *optional(follows_origin=ORIGIN, follows_number=Integer),
    *required(decided_by=String(16)),
    *optional(work_sha256=SHA256, input_sha256=SHA256),
    *required(made_at=UtcTime, actor=Text, reason=Text),
    sa.ForeignKeyConstraint(["lot_id", "serial"], ["units.lot_id", "units.serial"]),
    sa.ForeignKeyConstraint(
        ["serial", "revision", "made_by"], ["calibrations.serial", "calibrations.revision", "calibrations.origin"]
    ),
    CheckConstraint("number >= 1", name="number"),
    Index("ix_in_use_lot_id_serial", "lot_id", "serial", "made_at"),
    Index("ix_in_use_serial", "serial"),
)
"""Which calibration a unit of a lot uses, as statements: each names the one it follows. Two that
nothing follows and that name different maps are a conflict, which a person ends."""

audit = table(
    "audit",
    *keys(origin=ORIGIN, seq=Integer),
    *required(at=UtcTime, actor=Text, action=String(32), entity=String(32), key=Text),
    *optional(before=Text, after=Text),
    *required(reason=Text, prev_hash=SHA256, hash=SHA256),
    Index("ix_audit_entity_key", "entity", "key"),
)

work_items = table(
    "work_items",
    Column("id", sa.BigInteger().with_variant(Integer, "sqlite"), primary_key=True, autoincrement=True),
    *required(lot_id=NAME, serial=NAME, kind=String(32), work_set=SHA256, input_sha256=SHA256),
    *required(state=String(8), attempts=Integer),
    *optional(owner=Text, lease_until=UtcTime),
    *required(changed_at=UtcTime),
    CheckConstraint("state IN ('queued', 'claimed', 'failed')", name="state"),
    Index("uq_work_items_item", "lot_id", "kind", "serial", "work_set", "input_sha256", unique=True),
    Index("ix_work_items_set_state", "lot_id", "kind", "work_set", "state", "id"),
    Index("ix_work_items_owner", "owner", "state"),
)

adaptations = table(
    "adaptations",
    *keys(lot_id=NAME, serial=NAME, number=Integer, origin=ORIGIN),
    *required(revision=Integer, stream=Text, sample=Integer, made_at=UtcTime, entry=CanonicalJson),
    sa.ForeignKeyConstraint(["lot_id", "serial"], ["units.lot_id", "units.serial"]),
    CheckConstraint("number >= 1", name="number"),
)

certificates = table(
    "certificates",
    *keys(cell_serial=NAME, issued_on=sa.Date, origin=ORIGIN),
    *required(due_on=sa.Date, number=Text, laboratory=Text, capacity_N=Double, uncertainty_N=Double),
    Column("blob_sha256", SHA256, ForeignKey("blobs.sha256")),
    *required(added_at=UtcTime),
    CheckConstraint("due_on > issued_on", name="due_on"),
)

golden_runs = table(
    "golden_runs",
    *keys(station=NAME, lot_id=NAME, serial=NAME, made_at=UtcTime, origin=ORIGIN),
    *required(value=Double, unit=Text, passed=sa.Boolean, reasons=CanonicalJson, actor=Text),
    *optional(recording_sha256=SHA256),
)

users = table(
    "users",
    *keys(name=NAME),
    *required(role=String(16), pin_hash=Text, is_active=sa.Boolean, failures=Integer),
    *optional(locked_until=UtcTime),
    *required(version=Integer, changed_at=UtcTime),
    CheckConstraint("role IN ('operator', 'engineer', 'quality')", name="role"),
)

orders = table(
    "orders",
    *keys(order_id=NAME),
    *required(station=NAME, kind=String(16), serial=NAME, lot_id=NAME, actor=Text, reason=Text),
    *required(created=UtcTime, state=String(16), phase=Text, fraction=Double, remaining_s=Double),
    *required(code=Text, message=Text, recording_sha256=Text, verdict=Text),
    *required(changed_at=UtcTime),
    CheckConstraint("state IN ('queued', 'running', 'done', 'error', 'cancelled')", name="state"),
    Index("ix_orders_station", "station", "created"),
)
Index("uq_orders_active", orders.c.station, unique=True)
# Of runs that are not over: the migration says which, as naming a dialect here would load both.

run_signals = table(
    "run_signals",
    Column("order_id", ForeignKey("orders.order_id"), primary_key=True),
    *required(signal=CanonicalJson),
)

heartbeats = table(
    "heartbeats",
    *keys(station=NAME),
    *required(state=String(16), at=UtcTime, reasons=CanonicalJson, process=Text, order_id=NAME),
    *required(gate=CanonicalJson, is_overridden=sa.Boolean),
)

line_places = Table("line_places", metadata, *keys(station=NAME), *required(version=Integer, place=CanonicalJson))

network_releases = table(
    "network_releases",
    Column("network_id", ForeignKey("networks.id"), primary_key=True),
    *keys(made_at=UtcTime, origin=ORIGIN),
    Column("lot_id", ForeignKey("lots.id"), nullable=False),
    *required(state=String(16), actor=Text, reason=Text),
    CheckConstraint("state IN ('released', 'withdrawn')", name="state"),
)

jobs = table(
    "jobs",
    *keys(job_id=String(32)),
    *required(kind=String(32), request=CanonicalJson, actor=Text, created=UtcTime, state=String(16)),
    *required(fraction=Double, message=Text, trace=CanonicalJson, result=CanonicalJson),
    Column("blob_sha256", SHA256, ForeignKey("blobs.sha256")),
    *required(is_cancel_wanted=sa.Boolean, beaten_at=UtcTime),
    CheckConstraint("state IN ('queued', 'running', 'done', 'error', 'cancelled')", name="state"),
    Index("ix_jobs_kind", "kind", "created"),
)

tokens = table(
    "tokens",
    *keys(token_id=String(32)),
    *required(sha256=SHA256),
    Column("account", ForeignKey("users.name"), nullable=False),
    *required(purpose=Text, created=UtcTime, ends_at=UtcTime, is_withdrawn=sa.Boolean),
    Index("uq_tokens_sha256", "sha256", unique=True),
)

deliveries = table(
    "deliveries",
    *keys(destination=NAME),
    *required(cursor=CanonicalJson, delivered=sa.BigInteger, failures=Integer),
    *optional(not_before=UtcTime),
    *required(error=Text, changed_at=UtcTime),
    *optional(holder=String(128), held_until=UtcTime),
)

AUDITED = tuple(
    "lots limits line_rules units recordings networks network_releases methods fits trims corrections "
    "sample_releases audits calibrations lot_decisions "
    "refusals in_use adaptations "
    "certificates golden_runs line_spreads map_families lot_sources source_networks lot_references "
    "known_loads load_readings unit_golden_runs exports confirmed_audits draws drawn_units lot_statements "
    "checked_units station_qualifications laboratories alerts".split()
)
"""Tables whose every row stands in the audit trail, too, in the order rows may be copied."""

APPEND_ONLY = ("blobs", "audit", *AUDITED)
"""Tables whose rows are never changed or deleted; triggers on both databases see to it."""

HASHED_COLUMNS = {"adaptations": ("entry",)}
"""Columns of which the audit trail holds a SHA-256 only, as there are thousands of rows a day."""
