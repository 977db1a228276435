"""PostgreSQL with 50,000 units in fifty lots: how many rows each question of line, lot page, batch and verify touches.

Rows are counted from EXPLAIN ANALYZE of the very statements, so that a fast machine hides no full scan.
"""

from collections.abc import Callable

import pytest
from sqlalchemy import event, text

from softcal.core.lot import Lot
from softcal.core.messages.reason import plain
from softcal.db.queues.work_queue import WorkSet
from softcal.db.registry import Registry
from softcal.db.repositories.lot_pages import UnitFilter
from softcal.db.schema.tables import calibrations, in_use

UNITS, LOTS = 50_000, 50
OF_A_LOT = UNITS // LOTS
FEW = 2_500
"""Rows that a question of one unit, or of a chunk of a hundred, may touch."""


def fill(registry: Registry, units: int, lots: int) -> None:
    """Put units with two calibrations and recordings each beside the one that is there, past the API."""
    calibration_columns = [f'"{c.name}"' for c in calibrations.c if c.name not in ("lot_id", "serial", "revision")]
    in_use_columns = [f'"{c.name}"' for c in in_use.c if c.name not in ("lot_id", "serial", "number")]
    statements = [
        f"CREATE TEMPORARY TABLE made AS SELECT 'lot-' || (k % {lots}) AS lot_id, "
        f"'U' || lpad(CAST(k AS text), 6, '0') AS serial, k FROM generate_series(1, {units}) k",
        "INSERT INTO units SELECT lot_id, serial, 'target', now() FROM made",
        f"INSERT INTO calibrations (lot_id, serial, revision, {', '.join(calibration_columns)}) "
        f"SELECT m.lot_id, m.serial, r, t.{', t.'.join(calibration_columns)} "
        "FROM made m, generate_series(1, 2) r, calibrations t WHERE t.serial = 'A1'",
        f"INSERT INTO in_use (lot_id, serial, number, {', '.join(in_use_columns)}) "
        f"SELECT m.lot_id, m.serial, r, t.{', t.'.join(in_use_columns)} "
        "FROM made m, generate_series(1, 2) r, in_use t WHERE t.serial = 'A1'",
        "INSERT INTO refusals SELECT m.lot_id, m.serial, now(), 'f', 'kim', 'retest', '[]', NULL FROM made m "
        "WHERE k % 2 = 0",
        'INSERT INTO recordings (sha256, lot_id, kind, serial, samples, "sample_rate_Hz", output_unit, output_sha256, '
        "blob_sha256, added_at) SELECT md5(m.serial) || md5(m.serial), m.lot_id, 'unit', m.serial, 60, 50, 'V', "
        "md5(m.serial) || md5(m.serial), b.sha256, now() FROM made m, (SELECT sha256 FROM blobs LIMIT 1) b",
        "INSERT INTO audit SELECT 'ffffffffffff', 4 * k + r, now(), 'kim', 'calibrate', (ARRAY['calibrations', "
        "'in_use', 'units', 'recordings'])[r + 1], m.serial || r, NULL, '{}', '', repeat('0', 64), repeat('0', 64) "
        "FROM made m, generate_series(0, 3) r",
        "INSERT INTO work_items (lot_id, serial, kind, work_set, input_sha256, state, attempts, changed_at) "
        "SELECT lot_id, serial, 'calibrate', repeat('a', 64), repeat('b', 64), 'queued', 0, now() FROM made",
    ]
    with registry.database.writing() as connection:
        # Whose rows stand for which is of no account here, and checking it takes a minute.
        connection.execute(text("SET LOCAL session_replication_role = replica"))
        for statement in statements:
            connection.execute(text(statement))


def rows_touched(registry: Registry, question: Callable[[], object]) -> int:
    """Ask, then explain every statement that was sent, and add up the rows their scans looked at."""
    engine, statements, settings = registry.database.engine, [], ["SELECT 1;"]

    def remember(connection, cursor, statement, parameters, context, executemany):
        if statement.startswith("SET LOCAL"):
            settings.append(f"{statement};")
        if statement.lstrip()[:6] in ("SELECT", "UPDATE", "DELETE") and not executemany:
            statements.append((statement, parameters))

    event.listen(engine, "before_cursor_execute", remember)
    try:
        question()
    finally:
        event.remove(engine, "before_cursor_execute", remember)
    total = 0
    for statement, parameters in statements:
        with engine.connect() as connection:
            connection.exec_driver_sql("".join(settings))
            explained = f"EXPLAIN (ANALYZE, FORMAT JSON) {statement}"
            total += _scanned(connection.exec_driver_sql(explained, parameters).scalar_one()[0]["Plan"])
            connection.rollback()
    return total


def _scanned(plan: dict) -> int:
    rows = 0
    if "Relation Name" in plan or plan["Node Type"].endswith("Scan"):
        looked_at = ("Actual Rows", "Rows Removed by Filter", "Rows Removed by Index Recheck")
        rows = sum(plan.get(name, 0) for name in looked_at) * plan["Actual Loops"]
    return int(rows) + sum(_scanned(part) for part in plan.get("Plans", ()))


def about_a_lot(registry: Registry, lot_id: str) -> dict[str, Callable[[], object]]:
    """Questions that are about every unit of a lot."""
    return {
        "page": lambda: registry.pages.unit_page(lot_id, UnitFilter(sort="severity"), size=50, before=3),
        "counts": lambda: registry.pages.verdict_counts(lot_id),
        "errors": lambda: registry.pages.lot_errors(lot_id),
        "list": lambda: registry.lots.units(lot_id),
        "runs": lambda: registry.lots.runs(lot_id),
    }


@pytest.mark.parametrize("registry_url", ["postgresql"], indirect=True)
def test_a_lot_that_was_just_written_costs_rows_as_many_as_it_has(registry, make_factory):
    """Of such a lot PostgreSQL has no statistics: it expects one row, and took the cube of the units."""
    units = 300
    make_factory(registry, "lot-0").calibrate("A1", 1)
    with registry.database.writing() as connection:
        for table in ("units", "calibrations", "in_use", "refusals"):
            connection.execute(text(f"ALTER TABLE {table} SET (autovacuum_enabled = false)"))
    fill(registry, units, 1)
    touched = {name: rows_touched(registry, ask) for name, ask in about_a_lot(registry, "lot-0").items()}
    assert {name: rows for name, rows in touched.items() if rows > 50 * units} == {}


@pytest.mark.long
@pytest.mark.parametrize("registry_url", ["postgresql"], indirect=True)
def test_no_question_touches_more_rows_than_it_is_about(registry, make_factory, recording_of):
    factory = make_factory(registry, "lot-3")
    factory.calibrate("A1", 1)
    registry.recordings.add("lot-3", recording_of("A1"), "unit")
    for k in range(LOTS):
        if k != 3:
            registry.lots.add(Lot(f"lot-{k}", "S0", 50.0))
    fill(registry, UNITS, LOTS)
    with registry.database.writing() as connection:
        connection.execute(text("ANALYZE"))
    queue, work = registry.work_queue, WorkSet("lot-3", "a" * 64)
    hundred = [f"U{LOTS * k + 3:06d}" for k in range(100)]
    works = dict.fromkeys(hundred, "c" * 64)
    about_a_unit = {
        "serials": lambda: registry.pages.find_units(""),
        "calibration": lambda: registry.calibrations.get("A1", lot_id="lot-3"),
        "history": lambda: registry.calibrations.history("A1"),
        "unit": lambda: registry.lots.units(serial="A1"),
        "unit of a lot": lambda: registry.lots.units("lot-3", "A1"),
        "runs of a unit": lambda: registry.lots.runs("lot-3", "A1"),
        "known": lambda: registry.calibrations.find("A1", factory.state("A1").fit.id, lot_id="lot-3"),
        "unknown serial": lambda: registry.calibrations.lots_of("Z9"),
        "calibrate": lambda: factory.calibrate("A1", 2),
        "again in use": lambda: registry.calibrations.put_in_use("lot-3", "A1", factory.state("A1").fit.id, "line"),
        "refuse": lambda: registry.calibrations.refuse("lot-3", "A1", "retest", (plain("cable"),)),
        "record": lambda: registry.recordings.add("lot-3", recording_of("A1", 5), "unit"),
        "roll back": lambda: registry.calibrations.rollback("A1", 2, reason="test", lot_id="lot-3"),
        "recordings of a unit": lambda: registry.recordings.of_lot("lot-3", "A1"),
        "marker of a page": lambda: registry.pages.change_marker("lot-3"),
        "newest rows of the trail": lambda: registry.trail.newest(50),
        "decided": lambda: registry.calibrations.decided_works("lot-3", hundred),
        "asked before": lambda: registry.calibrations.inputs_of_works("lot-3", works),
        "inputs": lambda: registry.calibrations.stored_inputs("lot-3", hundred),
        "standings": lambda: registry.pages.unit_statuses("lot-3", hundred),
        "claim": lambda: queue.claim("me", work, 100, 60),
        "lock_leased": lambda: queue.lock_leased("me", [1, 2, 3]),
        "owners": lambda: queue.owners(work),
        "extend": lambda: queue.extend("me", 60),
        "give back": lambda: queue.give_back("me"),
        "given up": lambda: queue.exhausted_items(work),
    }
    of_a_lot = about_a_lot(registry, "lot-3") | {
        "work left": lambda: queue.counts(work=work),
        "enqueue": lambda: queue.enqueue(work, {f"U{LOTS * k + 3:06d}": "b" * 64 for k in range(OF_A_LOT)}),
    }
    touched = {name: rows_touched(registry, question) for name, question in (about_a_unit | of_a_lot).items()}
    max_rows = dict.fromkeys(about_a_unit, FEW) | dict.fromkeys(of_a_lot, 50 * OF_A_LOT)
    assert {name: rows for name, rows in touched.items() if rows > max_rows[name]} == {}
    everything = rows_touched(registry, lambda: registry.verify(is_quick=True))
    assert everything < 2 * 10 * UNITS
