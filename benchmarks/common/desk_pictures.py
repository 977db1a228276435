"""Pictures of the desk: every page, light and dark. Run by screenshots.py.

A simulated lot is calibrated, a rig diagnosed and a unit followed first, so that every page has something to show.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, date, datetime, timedelta
from pathlib import Path

import numpy as np
from common.planted import planted
from common.screens import THEMES, Theme, save_picture, served
from playwright.sync_api import Browser, Page, ViewportSize

from softcal.app.calibration.changes import change_limit
from softcal.app.cli.main import main as softcal
from softcal.app.files.recording_file import write_columns
from softcal.app.gap.page_cases import practise
from softcal.app.jobs.jobs import run_job
from softcal.core.lot import UnitKey
from softcal.core.messages.reason import reason
from softcal.core.recording import Array, OutputRecording
from softcal.core.simulated_lot import LotDesign, simulate_lot
from softcal.db.connection import open_registry
from softcal.db.entries import CellCertificate, GoldenRun
from softcal.db.registry import Registry

SIZE = ViewportSize(width=1280, height=1000)
LOT = "2026-47"
NAME, PIN = "Erin", "2580"
QUALITY, QUALITY_PIN = "Quinn", "7777"
SETTLE_MS = 1500
"""Charts and tables draw themselves in the browser after the page is there."""

PAGES = {
    "lots": "lots",
    "lot": f"lot?lot={LOT}",
    **{tab: f"lot?lot={LOT}&tab={tab}" for tab in ("units", "audit", "release", "limits", "networks")},
    "unit": f"unit?unit={LOT}/U025",
    "long-term": f"unit?unit={LOT}/U005&tab=history",
    "source": f"lots?tab=rig&lot={LOT}",
    "gap": "gap",
    "wall": f"line?wall&lot={LOT}",
    "station": "station",
    "profiles": "station?tab=profiles",
    "load-cells": "station?tab=cells",
}
PAGES_OF_QUALITY = {"people": "settings?tab=people", "audit-trail": "settings?tab=audit_trail"}
SIGN_IN = "sign-in"
"""Name of the picture and address of the page; the pictures are `desk-NAME-light.png` and `desk-NAME-dark.png`."""

LOT_TOML = f"""sample_rate_Hz = 50.0
source = "S0"
[lot]
id = "{LOT}"
sensor_model = "eGaIn pad, 3 mm"
[reference]
unit = "N"
[output]
unit = "V"
[limit]
rmse = 0.15
"""


def fill(url: str, folder: Path) -> None:
    """Calibrate a simulated lot with good and bad units, and add what the other pages show."""
    write_lot(folder / "lot")
    softcal(["batch", str(folder / "lot"), "--registry", url, "--hidden", "24,12"])
    with open_registry(url) as registry:
        registry.people.set(QUALITY, "quality", QUALITY_PIN, actor="installation")
        registry.people.set(NAME, "engineer", PIN, actor=QUALITY)
        registry.people.set("Oh", "operator", "1111", actor=QUALITY)
        change_limit(registry, LOT, 0.14, reason="drawing D 117 rev. B", actor=NAME)
        registry.stations.add_certificate(
            CellCertificate("K1", "2026-0815", "Calibration laboratory", date(2026, 1, 5), date(2036, 1, 5), 20.0, 0.02)
        )
        add_golden_runs(registry)
        add_course(registry)
        jobs = (
            ({"lot": LOT, "hidden": [32, 16], "seed": 0, "members": 1, "max_epochs": 60}, "train"),
            (
                {"case": str(practise("usual"))},
                "diagnose",
            ),
        )
        for request, kind in jobs:
            run_job(registry, registry.job_board.place(kind, request, NAME), on_cancel=lambda: None)
        networks = [entry.id for entry in registry.networks.all()]
        request = {"lot": LOT, "networks": networks, "families": ["auto", "affine", "monotone"], "units": 8}
        run_job(registry, registry.job_board.place("compare", request, NAME), on_cancel=lambda: None)
        check: dict[str, object] = {"ports": [], "file": None, "simulated": 0, "may_move": True}
        run_job(registry, registry.job_board.place("station_check", check, NAME), on_cancel=lambda: None)


def write_lot(folder: Path) -> None:
    """Write a lot folder of a source, twenty good units and one of each of six faults; every other one is audited."""
    faults = ("dead", "saturated", "reversed", "other sensor", "wrong programme", "extra creep")
    design = LotDesign(good=20, bad=planted(faults), unit_s=40, audit_s=60, has_stage=True)
    sim = simulate_lot(7, design)
    folder.mkdir(parents=True)
    (folder / "lot.toml").write_text(LOT_TOML)
    write_columns(folder / "source/S0.csv", columns(sim.source.unlabelled, sim.source.reference))
    for k, unit in enumerate(sim.units):
        write_columns(folder / f"units/{unit.serial}.csv", columns(unit.recording))
        if k % 2 == 0:
            write_columns(folder / f"audit/{unit.serial}.csv", columns(unit.audit.unlabelled, unit.audit.reference))


def columns(recording: OutputRecording, reference: Array | None = None) -> list[tuple[str, Array]]:
    """Return the columns of a lot folder's file."""
    optional = (("reference", reference), ("stage_mm", recording.stage_mm))
    given_columns = [(name, values) for name, values in optional if values is not None]
    return [("t_s", recording.t_s), ("output", recording.output), *given_columns]


def add_golden_runs(registry: Registry) -> None:
    """Add two weeks of checks with a golden unit, one of them outside its limits."""
    rng = np.random.default_rng(3)
    for k in range(16):
        is_good, value = k != 12, 0.09 if k == 12 else float(0.062 + 0.003 * rng.normal())
        at = datetime.now(UTC) - timedelta(hours=12 * (16 - k))
        above = reason("golden.error", error=value, unit="N", what=reason("golden.own_limit"), limit=0.0742)
        reasons = () if is_good else (above,)
        registry.stations.add_golden_run(GoldenRun("line-1", LOT, "S0", at, value, "N", is_good, reasons, "Oh"))


def add_course(registry: Registry) -> None:
    """Add eight hours of drift of two units in use."""
    rng = np.random.default_rng(4)
    for serial, drift in (("U005", 1.0), ("U009", 0.3)):
        shift = np.cumsum(0.004 * drift + 0.004 * rng.normal(size=160))
        steps = [step(k, float(shift[k]), drift) for k in range(160)]
        registry.adaptations.add(UnitKey(LOT, serial), registry.calibrations.get(serial).revision, steps)


def step(k: int, shift: float, drift: float) -> dict[str, object]:
    """Return one step of an adaptation as the registry keeps it."""
    predicted = 0.061 + 0.00042 * drift * k * (0.6 + k / 200)
    event = "held" if k in (60, 61, 62) else "followed"
    values = {"stream": "line 3, week 47", "sample": 9000 * k, "row": 9000 * k, "t_s": 180.0 * k, "event": event}
    drifted = {"shift": shift, "log_gain": 0.05 * shift, "shift_sd": 0.02 + 1e-4 * k, "log_gain_sd": 0.01}
    alarm = "the predicted error has grown past the limit; calibrate against a reference"
    reason_fields = {
        "reason": "another use, not drift" if event == "held" else "",
        "alarm": alarm if predicted > 0.15 else "",
    }
    unit_map = {"gain": 1 - 0.02 * shift, "offset": 0.01 * shift, "predicted_rmse": predicted, "verdict": event}
    return {**values, **drifted, **unit_map, **reason_fields}


@contextmanager
def station_served(url: str) -> Iterator[None]:
    """Serve a simulated station beside the application."""
    command = [str(Path(sys.executable).with_name("softcal")), "station", "serve", "--simulated", "--name", "line-1"]
    quiet = subprocess.DEVNULL
    station = subprocess.Popen([*command, "--registry", url], stdout=quiet, stderr=quiet)
    try:
        yield
    finally:
        station.terminate()
        station.wait()


def take(page: Page, address: str, pages: Mapping[str, str], theme: Theme, out: Path) -> None:
    """Take the picture of some pages in one theme."""
    for name, path in pages.items():
        page.goto(f"{address}/{path}")
        settle(page)
        save_picture(page, out / f"desk-{name}-{theme}.png")


def settle(page: Page) -> None:
    """Wait until a page is drawn to its end."""
    page.get_by_role("main").wait_for(timeout=60_000)
    page.locator("[data-testid=stApp][data-test-script-state=notRunning]").wait_for(timeout=60_000)
    page.wait_for_timeout(SETTLE_MS)
    page.locator("[data-testid=stSkeleton]").first.wait_for(state="detached", timeout=60_000)
    page.locator("[data-testid=stApp][data-test-script-state=notRunning]").wait_for(timeout=60_000)
    page.wait_for_timeout(SETTLE_MS)


def sign_in(page: Page, address: str, name: str, pin: str) -> None:
    """Sign in."""
    page.goto(f"{address}/settings")
    page.get_by_label("Name").fill(name)
    page.get_by_label("PIN", exact=True).fill(pin)
    page.keyboard.press("Enter")
    page.get_by_role("heading", name=name).wait_for(timeout=60_000)
    # The browser is told to remember the sign-in at the end of the run that drew the heading.
    while not any("session" in cookie["name"] for cookie in page.context.cookies()):
        page.wait_for_timeout(200)


def take_all(browser: Browser, out: Path, names: Collection[str]) -> None:
    """Take the picture of the named pages in both themes."""
    people = ((NAME, PIN, PAGES), (QUALITY, QUALITY_PIN, PAGES_OF_QUALITY), ("", "", {SIGN_IN: "settings"}))
    with tempfile.TemporaryDirectory(prefix="softcal-screens-") as root:
        os.environ["XDG_DATA_HOME"] = root
        url = f"sqlite:///{Path(root) / 'registry.db'}"
        os.environ["SOFTCAL_REGISTRY"] = url
        fill(url, Path(root))
        with served(url) as (address, _), station_served(url):
            for theme in THEMES:
                for name, pin, pages in people:
                    context = browser.new_context(viewport=SIZE, color_scheme=theme)
                    page = context.new_page()
                    if name:
                        sign_in(page, address, name, pin)
                    take(page, address, {k: path for k, path in pages.items() if k in names}, theme, out)
                    context.close()
