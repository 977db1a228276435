"""The page of the source from an empty registry to a trained network, on a simulated station that really presses."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from softcal.app.texts.catalogue import text
from softcal.core.orders import OrderKind, RunState
from softcal.db.connection import open_registry
from tests.wait import wait_until

pytestmark = pytest.mark.long

STATION, LOT = "line-1", "LOT-9"
SHORT = ("--speed", "200", "--unit-seconds", "12", "--source-seconds", "25", "--hidden", "12,6")
LONGEST_S = 120


@pytest.fixture
def url(tmp_path: Path, serve_station: Callable):
    """The URL of an empty registry with a simulated station that serves it."""
    url = f"sqlite:///{tmp_path / 'source.db'}"
    with serve_station(url, STATION, tmp_path, *SHORT):
        yield url


def _press(screen, key: str):
    """Press the button that a text of the catalogue names."""
    next(button for button in screen.button if button.label == text("en", key)).click().run()
    assert not screen.error


def test_a_source_is_registered_pressed_looked_at_and_trained_from_its_page(url: str, show) -> None:
    screen = show(url, "lots", tab="rig", role="engineer")
    for field, value in zip(screen.text_input, (LOT, "A0", "eGaIn pad, 3 mm"), strict=False):
        field.set_value(value)
    _press(screen, "source.add_lot")
    _press(screen, "source.step.2")
    with open_registry(url) as registry:
        runs = partial(registry.order_queue.runs, STATION)
        wait_until(lambda: not runs()[0][1].state.is_active, runs, LONGEST_S)
        (order, progress), *_ = runs()
        assert (order.kind, order.serial, order.lot_id) == (OrderKind.SOURCE, "A0", LOT)
        assert progress.state is RunState.DONE, progress.text
        (recording,) = registry.recordings.of_lot(LOT, kind="source")
        (network,) = registry.networks.all()
    screen.run()
    assert not screen.error and screen.success
    assert str(recording.samples) in {metric.value for metric in screen.metric}
    assert any(network.id[:12] in line.value for line in screen.markdown)
