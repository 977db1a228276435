"""What a transaction remembers of the registry: fewer statements a unit, and nothing that a savepoint took back."""

import pytest
from sqlalchemy import event

SERIALS = tuple(f"U{number}" for number in range(10))
STATEMENTS_A_UNIT = 21
"""Savepoint, unit, recording with its blob, calibration with its blob, statement of use, four rows of the trail. Asking
again for what the chunk knows took 31."""


def store_calibration(factory, recording_of, serial, number=1):
    registry = factory.registry
    with registry.part():
        registry.recordings.add(factory.lot_id, recording_of(serial), "unit")
        return registry.calibrations.add(factory.lot_id, factory.state(serial, number), work_sha256="f" * 64)


def test_a_chunk_asks_once_for_what_its_units_share(factory, recording_of):
    registry, statements = factory.registry, []
    event.listen(registry.database.engine, "before_cursor_execute", lambda *told: statements.append(told[2]))
    with registry.transaction():
        store_calibration(factory, recording_of, "first")
        statements.clear()
        for serial in SERIALS:
            assert store_calibration(factory, recording_of, serial) == 1
    # Savepoint and release are no statements of a cursor.
    assert len(statements) <= (STATEMENTS_A_UNIT - 2) * len(SERIALS), "\n".join(
        statements[: len(statements) // len(SERIALS)]
    )
    assert registry.verify() == []
    assert {unit.serial for unit in registry.lots.units(factory.lot_id)} >= set(SERIALS)


def test_what_a_savepoint_takes_back_is_found_again(factory, recording_of):
    registry = factory.registry
    with registry.transaction():
        store_calibration(factory, recording_of, "A")
        with pytest.raises(ZeroDivisionError), registry.part():
            store_calibration(factory, recording_of, "B", 7)
            raise ZeroDivisionError
        store_calibration(factory, recording_of, "B", 7)
        store_calibration(factory, recording_of, "C")
    assert registry.verify() == []
    assert [len(registry.calibrations.history(serial)) for serial in "ABC"] == [1, 1, 1]
    assert registry.recordings.get(recording_of("B").sha256).serial == "B"


def test_a_second_calibration_in_one_transaction_follows_the_first(factory, recording_of):
    registry = factory.registry
    with registry.transaction():
        assert [store_calibration(factory, recording_of, "A", number) for number in (1, 2, 3)] == [1, 2, 3]
    assert registry.verify() == []
    assert [stored.is_current for stored in registry.calibrations.history("A")] == [False, False, True]


def test_a_transaction_that_failed_leaves_nothing_behind(factory, recording_of):
    registry = factory.registry
    with pytest.raises(ZeroDivisionError), registry.transaction():
        store_calibration(factory, recording_of, "A")
        raise ZeroDivisionError
    with registry.transaction():
        assert store_calibration(factory, recording_of, "A") == 1
    assert registry.verify() == []
