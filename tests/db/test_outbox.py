"""The audit trail as outbox: every row behind a cursor comes once, in the order of its chain, and cursors stay."""

from datetime import UTC, datetime

import pytest

from softcal.core.errors import InputError
from softcal.db.connection import open_registry
from softcal.db.maintenance.sync import synchronise
from softcal.db.queues.outbox import cursor_of, cursor_text


def ids(rows):
    return [(row.origin, row.seq) for row in rows]


def test_pages_of_any_size_give_every_row_once(factory):
    for number in range(1, 8):
        factory.calibrate("A1", number)
    outbox = factory.registry.outbox
    everything = ids(outbox.after({}, 10**6))
    assert everything == ids(factory.registry.trail.rows())
    for size in (1, 3, 1000):
        cursor, rows_read = {}, []
        while rows := outbox.after(cursor, size):
            rows_read += ids(rows)
            cursor |= {row.origin: row.seq for row in rows}
        assert rows_read == everything and cursor == outbox.end()


def test_rows_of_another_registry_come_in_the_order_of_their_chain(factory, make_factory, file_registry):
    other = make_factory(file_registry, "L2")
    factory.calibrate("A1")
    before = factory.registry.outbox.end()
    other.calibrate("B1")
    synchronise(factory.registry, other.registry)
    rows = factory.registry.outbox.after(before, 1000)
    assert ids(rows) == ids(other.registry.trail.rows(other.registry.origin))


def test_a_destination_begins_once_and_stays_where_it_is(registry, registry_url):
    at = datetime(2026, 5, 4, tzinfo=UTC)
    registry.outbox.begin("mes", {"a": 3})
    registry.outbox.moved("mes", {"a": 5}, 2)
    registry.outbox.failed("mes", "nobody answers", at)
    with open_registry(registry_url) as again:
        destination = again.outbox.begin("mes", {"a": 99})
    assert (destination.cursor, destination.delivered, destination.failures) == ({"a": 5}, 2, 1)
    assert (destination.error, destination.not_before) == ("nobody answers", at)
    registry.outbox.moved("mes", {"a": 6}, 1)
    assert [(d.failures, d.error, d.not_before) for d in registry.outbox.deliveries()] == [(0, "", None)]


def test_a_cursor_comes_back_as_it_was_given():
    assert cursor_of(cursor_text({"a1": 3, "b2": 10})) == {"a1": 3, "b2": 10}
    assert cursor_of("") == {}


@pytest.mark.parametrize("text", ["x", "a:", ":3", "a:-1", "a:1e9", "a:٣", "a:1.", "a:12345678901", "a b:1"])
def test_a_cursor_that_was_not_given_is_refused(text):
    with pytest.raises(InputError):
        cursor_of(text)
