"""The short way of the stop key, asked of the real server: one order for a run, and for nobody from elsewhere."""

import http.client
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest

from softcal.core.lot import Lot
from softcal.core.orders import Heartbeat, Order, OrderKind, StationState
from softcal.db.connection import open_registry
from softcal.db.registry import Registry

KEY = {"x-softcal-key": "stop"}


@pytest.fixture
def line(tmp_path: Path, serve: Callable) -> Iterator[tuple[Registry, int]]:
    url = f"sqlite:///{tmp_path / 'line.db'}"
    with open_registry(url) as registry:
        registry.lots.add(Lot("L1", "A0", 50.0))
        registry.order_queue.write_heartbeat(Heartbeat("line-1", StationState.READY, datetime.now(UTC), (), "host:1"))
        with serve(url) as screen:
            yield registry, screen.port


def press_stop_key(port: int, headers: dict[str, str], body: str = "line-1") -> int:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    connection.request("POST", "/line-stop", body, headers)
    status = connection.getresponse().status
    connection.close()
    return status


@pytest.mark.long
def test_the_stop_key_orders_one_stop_of_the_run_and_only_from_its_own_page(line):
    registry, port = line
    assert press_stop_key(port, KEY) == 409  # Nothing runs.
    registry.order_queue.place(Order("run", "line-1", OrderKind.UNIT, "A1", "L1", "kim"))
    assert press_stop_key(port, {}) == 403
    assert press_stop_key(port, KEY | {"Host": "evil.example"}) == 421
    assert press_stop_key(port, KEY, "x" * 300) == 413
    assert [order.kind for order, _ in registry.order_queue.runs("line-1")] == [OrderKind.UNIT]
    assert press_stop_key(port, KEY) == press_stop_key(port, KEY, "") == 204
    assert [order.kind for order, _ in registry.order_queue.runs("line-1")].count(OrderKind.STOP) == 1
