"""The page of the source from an empty registry to a trained network, on a simulated station that really presses."""

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from softcal.core.orders import OrderKind, RunState
from softcal.db.connection import open_registry

pytestmark = pytest.mark.long

STATION, LOT = "line-1", "LOT-9"
SHORT = ("--speed", "200", "--unit-seconds", "12", "--source-seconds", "25", "--hidden", "12,6")
LONGEST_S = 120


def _source_page() -> None:
    from softcal.app.ui.app_pages import source

    source.render()


@pytest.fixture
def url(tmp_path: Path, serve_station: Callable):
    """The URL of an empty registry with a simulated station that serves it."""
    url = f"sqlite:///{tmp_path / 'source.db'}"
    with serve_station(url, STATION, tmp_path, *SHORT):
        yield url


def _button(screen, label: str):
    return next(button for button in screen.button if button.label == label)


def test_a_source_is_registered_pressed_looked_at_and_trained_from_its_page(url: str, open_page) -> None:
    screen = open_page(url, _source_page, role="engineer")
    for field, value in zip(screen.text_input, (LOT, "A0", "eGaIn pad, 3 mm"), strict=False):
        field.set_value(value)
    _button(screen, "Register the lot").click().run()
    assert not screen.error
    _button(screen, "Press the source unit").click().run()
    assert not screen.error
    with open_registry(url) as registry:
        deadline_s = time.monotonic() + LONGEST_S
        while (found := registry.order_queue.runs(STATION))[0][1].state.is_active:
            assert time.monotonic() < deadline_s, found
            time.sleep(0.2)
        (order, progress), *_ = found
        assert (order.kind, order.serial, order.lot_id) == (OrderKind.SOURCE, "A0", LOT)
        assert progress.state is RunState.DONE, progress.text
        (recording,) = registry.recordings(LOT, kind="source")
        (network,) = registry.networks()
    screen.run()
    assert not screen.error and screen.success
    facts = {metric.label: metric.value for metric in screen.metric}
    assert facts["Samples"] == str(recording.samples)
    assert any(network.id[:12] in line.value for line in screen.markdown)
