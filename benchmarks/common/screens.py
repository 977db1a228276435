"""What the benchmarks of the screens share: a line whose station is played by its rows, the application, a browser."""

import os
import shutil
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Literal

import numpy as np
from common.registries import state
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright
from plotly.graph_objects import Figure

from softcal.core.lot import Lot
from softcal.core.messages.reason import Reason, Value, reason
from softcal.core.network.network import Network
from softcal.core.orders import Condition, Heartbeat, Order, OrderKind, Progress, RunState, Signal, StationState
from softcal.core.quality.line_rules import LineRules
from softcal.core.simulated_lot import LotDesign, simulate_lot
from softcal.core.unit.adjustments import SampleRelease
from softcal.core.unit.state import UnitState
from softcal.core.unit.uncertainty import ErrorForecast, IntervalInflation
from softcal.core.unit.verdict import Finding, Limit, Verdict
from softcal.db.registry import Registry

FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--disable-background-networking"]
STATION, LOT = "line-1", "EG-2411"
Theme = Literal["light", "dark"]
THEMES: tuple[Theme, ...] = ("light", "dark")


def gate_condition(name: str, text: str, is_good: bool = True, **values: Value) -> Condition:
    """Return one thing the gate looked at: the name and the fact are codes of the gate."""
    return Condition(reason(f"gate.name.{name}"), is_good, reason(f"gate.{text}", **values))


GOOD = (
    gate_condition("certificate", "valid", number="DKD-K-0417", day="2027-02-28"),
    gate_condition("force_range", "reaches", force_N=12.0, most_N=20.0),
    gate_condition("warm_up", "warm", minutes=184),
    gate_condition("zero_return", "zero", moved_N=0.004, limit_N=0.2),
    gate_condition("homing", "homed"),
    gate_condition("golden", "golden", serial="G-03", at="06:12"),
)


def statement(rmse: float, lower: float, upper: float, relation: str) -> Reason:
    """Return the statement on a forecast against the limit of the lot."""
    numbers: dict[str, Value] = {"rmse": rmse, "lower": lower, "upper": upper, "limit": 0.12, "unit": "N"}
    phrases = {"source": "part.predicted", "relation": f"part.{relation}", "origin": "part.stated"}
    return reason("statement", **numbers, **{name: Reason(code) for name, code in phrases.items()})


WITHIN = (statement(0.071, 0.051, 0.096, "within"),)


class PlayedLine:
    """A registry with one lot, and its station played by writing the rows a station writes."""

    def __init__(self, registry: Registry) -> None:
        self.registry, self.queue = registry, registry.order_queue
        registry.lots.add(Lot(LOT, "EG-2411-000", 50.0, "eGaIn pad 20 mm", limit_rmse=0.12))
        network = Network((np.ones((15, 1)),), (np.zeros(1),), 0.0, 1.0, 0.0, 1.0)
        self.network_id = registry.networks.add(LOT, network, {}, {}, "0" * 64)
        registry.lots.set_line_rules(LOT, LineRules(r"EG-2411-\d{3}", "upper", 120), reason="order of the customer")
        self._count = 0

    def write_heartbeat(
        self, state: StationState = StationState.READY, gate: tuple[Condition, ...] = GOOD, why: Reason | None = None
    ) -> None:
        """Say that the station is there, and go on saying so every second."""
        reasons = (why,) if why else tuple(c.says for c in gate if not c.is_good)
        self._says = Heartbeat(STATION, state, datetime.now(UTC), reasons, "rig:1", gate=gate)
        self.queue.write_heartbeat(self._says)

    @contextmanager
    def alive(self) -> Iterator[None]:
        """Keep the heart beating during the block."""
        is_over = threading.Event()

        def go_on() -> None:
            while not is_over.wait(1.0):
                self.queue.write_heartbeat(replace(self._says, at=datetime.now(UTC)))

        self.write_heartbeat()
        heart = threading.Thread(target=go_on, daemon=True)
        heart.start()
        try:
            yield
        finally:
            is_over.set()
            heart.join()

    def place_order(self, serial: str, kind: OrderKind = OrderKind.UNIT) -> Order:
        """Order a run and let the station take it."""
        self._count += 1
        self.queue.place(Order(f"run-{self._count}", STATION, kind, serial, LOT, "Kim Ji-woo"))
        order = self.queue.take(STATION)
        if order is None:
            raise ValueError("an order was placed and none is there")
        return order

    def end(
        self,
        order: Order,
        verdict: str,
        reasons: tuple[Reason, ...] = WITHIN,
        code: str = "",
        message: Reason | None = None,
    ) -> None:
        """End a run and store its result."""
        ended = RunState.ERROR if code else RunState.DONE
        if verdict:
            self.registry.calibrations.add(LOT, self._result(order.serial, Verdict(verdict), reasons))
        messages = (message,) if message else reasons
        self.queue.report(Progress(order.order_id, ended, "done", 1.0, code=code, message=messages, verdict=verdict))

    def _result(self, serial: str, verdict: Verdict, reasons: tuple[Reason, ...]) -> UnitState:
        unit_state = state(serial, self._count, self.network_id)
        findings = () if verdict.is_open else tuple(Finding(why, verdict) for why in reasons)
        fit = replace(unit_state.fit, forecast=ErrorForecast(0.071, 0.051, 0.096), findings=findings)
        result = replace(unit_state, fit=fit, limit=Limit("N", 0.12))
        if verdict is not Verdict.PASS:
            return result
        release = SampleRelease(
            number=1,
            limit_rmse=0.12,
            is_released=True,
            scale=1.0,
            factor=1.4,
            interval_inflation=IntervalInflation(),
            day_rmse=0.0,
            audits=reason("part.here", audits=10),
            risk=0.1,
            confidence=0.9,
        )
        return replace(result, release=release)

    def press(
        self,
        serial: str,
        verdict: str,
        reasons: tuple[Reason, ...] = WITHIN,
        code: str = "",
        message: Reason | None = None,
    ) -> None:
        """Press one unit from order to end."""
        self.end(self.place_order(serial), verdict, reasons, code, message)


def pressed_signal(seconds: float = 38.0) -> Signal:
    """Return the live signal of a simulated unit, ten points a second."""
    recording = simulate_lot(3, LotDesign(good=1, has_stage=True)).units[0].recording
    if recording.stage_mm is None:
        raise ValueError("the lot was drawn with the stage's position and has none")
    step = slice(0, int(seconds * 50), 5)
    columns = (recording.t_s[step], recording.output[step], recording.stage_mm[step])
    t_s, output, stage_mm = (tuple(column.tolist()) for column in columns)
    return Signal(t_s, output, stage_mm, (), "V")


@contextmanager
def served(url: str) -> Iterator[tuple[str, int]]:
    """Serve the application on a registry; give its address and the id of its process."""
    command = [sys.executable, "-m", "softcal.app.ui.server", "--server.address=127.0.0.1", "--logger.level=error"]
    with served_by(command, dict(os.environ) | {"SOFTCAL_REGISTRY": url}) as address:
        yield address


@contextmanager
def served_by(
    command: list[str], environment: dict[str, str], out: IO[str] | int = subprocess.DEVNULL
) -> Iterator[tuple[str, int]]:
    """Run a Streamlit server at a free port; give its address and the id of its process. `out` gets what it prints."""
    port = free_port()
    server = subprocess.Popen([*command, f"--server.port={port}"], env=environment, stdout=out, stderr=out)
    try:
        while not is_healthy(f"http://127.0.0.1:{port}/_stcore/health"):
            time.sleep(0.2)
        yield f"http://127.0.0.1:{port}", server.pid
    finally:
        server.terminate()
        server.wait()


@contextmanager
def chromium() -> Iterator[Browser]:
    """Give a headless Chromium."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        yield browser
        browser.close()


def write_figure(figure: Figure, file: Path) -> None:
    """Write a figure as .html, or as the picture a browser makes of it."""
    if file.suffix != ".png":
        figure.write_html(file, include_plotlyjs="cdn")
        return
    with chromium() as browser:
        page = browser.new_page(viewport={"width": 1100, "height": 430}, device_scale_factor=1.5)
        page.set_content(figure.to_html(include_plotlyjs=True, config={"displayModeBar": False}))
        page.locator(".main-svg").first.wait_for()
        save_picture(page, file)


def save_picture(page: Page, path: Path) -> None:
    """Take a picture of what a browser shows, in 128 colours, and say how large it is."""
    page.screenshot(path=path)
    Image.open(path).convert("P", palette=Image.Palette.ADAPTIVE, colors=128).save(path, optimize=True)
    print(f"{path}: {path.stat().st_size / 1024:.0f} KiB", flush=True)


def free_port() -> int:
    """Return a TCP port nobody listens at."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def is_healthy(url: str) -> bool:
    """Whether a server answers at an address."""
    try:
        urllib.request.urlopen(url, timeout=2).close()
    except (urllib.error.URLError, OSError):
        return False
    return True
