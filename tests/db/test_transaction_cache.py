"""What a transaction remembers of the registry: fewer statements a unit, and nothing that a savepoint took back."""

import pytest
from sqlalchemy import event

SERIALS = tuple(f"U{number}" for number in range(10))
STATEMENTS_A_UNIT = 21
"""Savepoint, unit, recording with its blob, calibration with its blob, statement of use, four rows of the trail. Asking
again for what the chunk knows took 31."""


def keep(factory, recording_of, serial, number=1):
    registry = factory.registry
    with registry.part():
        registry.recordings.add(factory.lot_id, recording_of(serial), "unit")
        return registry.calibrations.add(factory.lot_id, factory.state(serial, number), work_sha256="f" * 64)


def test_a_chunk_asks_once_for_what_its_units_share(factory, recording_of):
    registry, seen = factory.registry, []
    event.listen(registry.database.engine, "before_cursor_execute", lambda *told: seen.append(told[2]))
    with registry.transaction():
        keep(factory, recording_of, "first")
        seen.clear()
        for serial in SERIALS:
            assert keep(factory, recording_of, serial) == 1
    # Savepoint and release are no statements of a cursor.
    assert len(seen) <= (STATEMENTS_A_UNIT - 2) * len(SERIALS), "\n".join(seen[: len(seen) // len(SERIALS)])
    assert registry.verify() == []
    assert {unit.serial for unit in registry.lots.units(factory.lot_id)} >= set(SERIALS)


def test_what_a_savepoint_takes_back_is_found_again(factory, recording_of):
    registry = factory.registry
    with registry.transaction():
        keep(factory, recording_of, "A")
        with pytest.raises(ZeroDivisionError), registry.part():
            keep(factory, recording_of, "B", 7)
            raise ZeroDivisionError
        keep(factory, recording_of, "B", 7)
        keep(factory, recording_of, "C")
    assert registry.verify() == []
    assert [len(registry.calibrations.history(serial)) for serial in "ABC"] == [1, 1, 1]
    assert registry.recordings.get(recording_of("B").sha256).serial == "B"


def test_a_second_calibration_in_one_transaction_follows_the_first(factory, recording_of):
    registry = factory.registry
    with registry.transaction():
        assert [keep(factory, recording_of, "A", number) for number in (1, 2, 3)] == [1, 2, 3]
    assert registry.verify() == []
    assert [stored.is_current for stored in registry.calibrations.history("A")] == [False, False, True]


def test_a_transaction_that_failed_leaves_nothing_behind(factory, recording_of):
    registry = factory.registry
    with pytest.raises(ZeroDivisionError), registry.transaction():
        keep(factory, recording_of, "A")
        raise ZeroDivisionError
    with registry.transaction():
        assert keep(factory, recording_of, "A") == 1
    assert registry.verify() == []
