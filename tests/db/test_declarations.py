"""What people and files declare has tables: the newest row of a key is in force, and the audit trail is a log of it."""

import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from sqlalchemy import inspect

from softcal.app.calibration.audit import audited_sample, confirmed_audits, draw_plan, lot_audit
from softcal.app.calibration.lot_context import declare_line_spread, declared_line_spread, declared_sources, lot_method
from softcal.app.export.laboratory import registry_laboratory
from softcal.app.registry.golden import find_golden_runs
from softcal.app.registry.known_loads import known_loads, store_loads
from softcal.app.registry.reference import declare_reference, lot_reference, reference_expanded
from softcal.core.maps.interface import Anchors
from softcal.core.quality.audit_plan import AuditConfig
from softcal.core.unit.line_spread import LineSpread
from softcal.db.connection import open_registry
from softcal.db.maintenance.backup import back_up, restore
from softcal.db.maintenance.sync import synchronise
from softcal.db.repositories.registry_base import RegistrySettings
from tests.declarations import CELL, LOADS, declare_all

TABLES = {
    "exports",
    "draws",
    "drawn_units",
    "checked_units",
    "source_networks",
    "load_readings",
    "lot_statements",
    "confirmed_audits",
    "lot_references",
    "line_spreads",
    "lot_sources",
    "map_families",
    "known_loads",
    "unit_golden_runs",
    "station_qualifications",
    "alerts",
    "laboratories",
}


def declared(registry, lot_id="L1") -> list[object]:
    """Return what is in force, as every caller reads it."""
    (loads,) = known_loads(registry, lot_id, ["U1"]).values()
    audit = lot_audit(registry, lot_id)
    return [
        lot_method(registry, lot_id).map.family,
        declared_line_spread(registry, lot_id),
        declared_sources(registry, lot_id),
        lot_reference(registry, lot_id),
        reference_expanded(registry, lot_id),
        (loads.loads.output.tolist(), loads.loads.reference.tolist(), loads.where, loads.actor, loads.at),
        find_golden_runs(registry, lot_id, ["U1"]),
        (audit.plan, dict(audit.forecasts), audit.limit.maximum_rmse, audited_sample(registry, lot_id)),
        confirmed_audits(registry, lot_id),
        registry_laboratory(registry).person.name,
        registry.declarations.newest("station_qualifications", "line-1")["due_on"],
    ]


def test_every_kind_of_domain_state_has_a_table_with_a_key(registry):
    schema = inspect(registry.database.engine)
    assert set(schema.get_table_names()) >= TABLES
    assert all(schema.get_pk_constraint(name)["constrained_columns"] for name in TABLES)


def test_what_is_in_force_is_read_from_its_table_and_not_from_the_trail(factory, labelled_of):
    declare_all(factory, labelled_of("S0"))
    before = declared(factory.registry)
    lies = {"recordings": {}, "networks": [], "family": "identity", "load": 0.5, "day": 0.5, "plan": {}, "is_passed": 0}
    for table in TABLES:
        factory.registry.trail.add("state", table, (factory.lot_id,), lies)
    assert declared(factory.registry) == before
    assert before[:3] == ["affine", LineSpread(0.05, 0.01), [factory.network_id]] and before[3] == CELL


def test_the_newest_of_a_key_is_in_force_and_the_same_again_is_no_row(factory, labelled_of):
    registry, lot_id = factory.registry, factory.lot_id
    declare_all(factory, labelled_of("S0"))
    count = len(registry.trail.rows())
    declare_reference(registry, lot_id, CELL, labelled_of("S0"))
    declare_line_spread(registry, lot_id, LineSpread(0.05, 0.01))
    assert store_loads(registry, lot_id, {"b" * 64: ("U1", LOADS)}, "file", actor="Erin") == 0
    assert len(registry.trail.rows()) == count
    other = replace(CELL, certificate="D-K-2")
    declare_reference(registry, lot_id, other, labelled_of("S0"))
    assert lot_reference(registry, lot_id) == other
    declare_reference(registry, lot_id, CELL, labelled_of("S0"))
    assert lot_reference(registry, lot_id) == CELL and not registry.verify()


def test_a_declaration_behind_a_clock_that_was_set_back_is_the_newest(registry_url, make_factory, labelled_of):
    now = datetime(2026, 5, 1, tzinfo=UTC)
    with open_registry(registry_url, RegistrySettings(clock=lambda: now)) as registry:
        factory = make_factory(registry)
        declare_line_spread(registry, factory.lot_id, LineSpread(0.05))
        now -= timedelta(days=1)
        declare_line_spread(registry, factory.lot_id, LineSpread(0.07))
        assert declared_line_spread(registry, factory.lot_id) == LineSpread(0.07)


def test_two_registries_have_the_same_in_force_after_a_sync(factory, labelled_of, file_registry):
    declare_all(factory, labelled_of("S0"))
    synchronise(factory.registry, file_registry)
    assert declared(file_registry) == declared(factory.registry)
    declare_line_spread(file_registry, factory.lot_id, LineSpread(0.09))
    draw_plan(file_registry, factory.lot_id, AuditConfig(random=2, doubtful=0), reason="a second sample")
    synchronise(factory.registry, file_registry)
    assert declared(file_registry) == declared(factory.registry) and not file_registry.verify()
    assert declared_line_spread(factory.registry, factory.lot_id) == LineSpread(0.09)


def test_a_backup_brings_back_what_is_in_force(factory, labelled_of, tmp_path):
    declare_all(factory, labelled_of("S0"))
    back_up(factory.registry.database, tmp_path / "backup.db")
    restore(tmp_path / "backup.db", f"sqlite:///{tmp_path / 'again.db'}")
    with open_registry(f"sqlite:///{tmp_path / 'again.db'}") as again:
        assert declared(again) == declared(factory.registry) and not again.verify()


def test_who_asks_for_one_unit_reads_no_others(factory):
    registry = factory.registry
    for number in range(5):
        store_loads(registry, factory.lot_id, {f"{number:064x}": (f"U{number}", LOADS)}, "line")
    assert [row["serial"] for row in registry.declarations.in_force("known_loads", factory.lot_id, ["U3"])] == ["U3"]


def test_a_value_that_is_no_number_stores_nothing(factory):
    broken = Anchors(np.array([0.1, np.nan]), np.array([1.0, 2.0]))
    loads = {"b" * 64: ("U1", LOADS), "c" * 64: ("U2", broken)}
    with pytest.raises(ValueError, match="JSON"):
        store_loads(factory.registry, factory.lot_id, loads, "file")
    assert not known_loads(factory.registry, factory.lot_id, ["U1", "U2"])


def test_the_trail_tells_of_every_declaration(factory, labelled_of):
    declare_all(factory, labelled_of("S0"))
    values = {row.entity: json.loads(row.after) for row in factory.registry.trail.rows() if row.entity in TABLES}
    assert values.keys() == TABLES
    assert values["load_readings"]["output"] == 0.2 and values["lot_references"]["certificate"] == "D-K-1"
