"""After any history every surface says the same of a lot: its verdicts, its audits, its limit, what is released."""

from collections import Counter
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.app.calibration.audit import confirmed_audits
from softcal.app.calibration.lot_decision import decision_in_force
from softcal.app.calibration.release import read_lot_status
from softcal.app.calibration.results import lot_results
from softcal.app.cli.main import main
from softcal.app.export.calibrated_unit import ExportOptions
from softcal.app.export.certificates.lot_statement import build_lot_statement
from softcal.app.export.export import lot_serials
from softcal.app.line.status import Screen, read_line
from softcal.app.registry.limit import lot_limit
from softcal.app.registry.quality import lot_yields
from softcal.app.texts.catalogue import text
from softcal.app.views.alerts import lot_alerts
from softcal.app.views.lot import lot_view
from softcal.app.views.wall import wall_view
from softcal.core.errors import InputError
from softcal.core.quality.lot_status import Disposition
from softcal.db.connection import open_registry
from softcal.db.entries import GoldenRun
from softcal.db.registry import Registry
from softcal.db.repositories.lot_pages import UnitFilter

LOT, UNITS = "large", 14
SMALL = ("--hidden", "16,8", "--no-own")


class History:
    """One lot through drawn events, each by the command or the function that a person's surface calls."""

    def __init__(self, folder: Path, url: str, rng: np.random.Generator, press: Callable[..., pd.DataFrame]) -> None:
        self.folder, self.url, self.rng, self.press = folder, url, rng, press
        self.told: list[str] = []
        self.passed: set[str] = set()
        self.draw()
        self.batch()

    def run(self, *arguments: object) -> int:
        code = main([*map(str, arguments), "--registry", self.url])
        assert code in (0, 1, 2)
        return code

    def serial(self) -> str:
        return f"{LOT}-{self.rng.integers(UNITS):02d}"

    def draw(self) -> None:
        """Fit the units without their audits and draw all of them, so that what is measured then is a sample."""
        audits, away = self.folder / "audit", self.folder.parent / "away"
        audits.rename(away)
        self.batch()
        self.run("lot", "audit-plan", LOT, "--random", "99")
        away.rename(audits)

    def batch(self) -> None:
        self.run("batch", self.folder, *SMALL)

    def audit(self) -> None:
        """Some unit's audit, right or wrong, by the folder or straight into the registry."""
        serial, seed = self.serial(), int(self.rng.integers(10_000))
        gain, offset_V = 1 + 0.1 * self.rng.normal(), 0.5 + 0.02 * self.rng.normal()
        table = self.press(900, gain, offset_V, seed)
        table["reference"] *= self.rng.choice([1.0, 1.0, 101.97])
        file = self.folder.parent / f"{serial}.csv"
        table.to_csv(file, index=False)
        self.run("lot", "audit", self.rng.choice([str(self.folder), LOT]), file)
        self.batch()

    def limit(self) -> None:
        self.run("lot", "limit", LOT, "--rmse", f"{self.rng.uniform(0.05, 0.5):.3f}", "--reason", "drawn", "--yes")

    def limit_of_another_registry(self) -> None:
        """A limit that comes without anybody judging by it."""
        with open_registry(self.url) as registry:
            registry.lots.set_limit(LOT, float(self.rng.uniform(0.05, 0.5)), reason="drawn elsewhere")

    def limit_taken_back(self) -> None:
        with open_registry(self.url) as registry:
            registry.lots.set_limit(LOT, None, reason="no drawing yet")

    def trim(self) -> None:
        outputs = 0.5 + np.array([0.0, 0.4]) * self.rng.uniform(0.8, 1.2)
        file = self.folder.parent / "loads.csv"
        pd.DataFrame({"output": outputs, "reference": [0.0, 4.0]}).to_csv(file, index=False)
        self.run("trim", "--serial", self.serial(), "--loads", file, "--yes")

    def roll_back(self) -> None:
        serial = self.serial()
        with open_registry(self.url) as registry:
            revisions = [stored.revision for stored in registry.calibrations.history(serial) if not stored.is_current]
        if revisions:
            arguments = ["--serial", serial, "--to", self.rng.choice(revisions), "--reason", "drawn", "--yes"]
            self.run("registry", "rollback", *arguments)

    def golden_fails(self) -> None:
        with open_registry(self.url) as registry:
            registry.stations.add_golden_run(GoldenRun("line", LOT, "A0", datetime.now(UTC), 9.0, "N", False))

    def confirm(self) -> None:
        with open_registry(self.url) as registry:
            doubted = [row.serial for row in read_lot_status(registry, LOT).audited if row.suspect_reason is not None]
        for serial in doubted[:1]:
            self.run("lot", "audit", LOT, "--confirm", serial, "--reason", "drawn", "--yes")
            with open_registry(self.url) as registry:
                assert serial in confirmed_audits(registry, LOT)

    def sync(self) -> None:
        """A second registry of the lot, in which the limit is another one, comes together with this one."""
        other = f"sqlite:///{self.folder.parent / 'other.db'}"
        self.run("registry", "sync", "--with", other)
        with open_registry(other) as registry:
            registry.lots.set_limit(LOT, float(self.rng.uniform(0.05, 0.5)), reason="set at the centre")
        self.run("registry", "sync", "--with", other)

    def step(self) -> None:
        events = (
            self.batch, self.audit, self.audit, self.audit, self.limit, self.limit_of_another_registry,
            self.limit_taken_back, self.trim, self.roll_back, self.golden_fails, self.confirm, self.sync,
        )  # fmt: skip
        event = events[int(self.rng.integers(len(events)))]
        self.told.append(event.__name__)
        event()


def verdicts_by_surface(registry: Registry) -> dict[str, dict[str, str | None]]:
    """Return the verdict of every unit as each surface reads it."""
    serials = [unit.serial for unit in registry.lots.units(LOT) if unit.role == "target"]
    unit_statuses = registry.pages.unit_statuses(LOT, serials)
    page = registry.pages.unit_page(LOT, UnitFilter(), size=1000).units
    results = lot_results(registry, LOT).to_pylist()
    return {
        "standings": {serial: one.verdict for serial, one in unit_statuses.items()},
        "units": {unit.serial: unit.verdict for unit in registry.lots.units(LOT) if unit.role == "target"},
        "page": {unit.serial: unit.verdict for unit in page},
        "results": {row["serial"]: row["verdict"] for row in results},
        "errors": {row.serial: row.verdict for row in registry.pages.lot_errors(LOT)},
    }


def check(history: History, tmp_path: Path) -> None:
    with open_registry(history.url) as registry:
        statuses = verdicts_by_surface(registry)
        expected_statuses = statuses["standings"]
        for surface, surface_statuses in statuses.items():
            assert {serial: surface_statuses[serial] for serial in surface_statuses} == {
                serial: expected_statuses[serial] for serial in surface_statuses
            }, surface
        view, translate = lot_view(registry, LOT), partial(text, "en")
        counted = Counter(expected_statuses.values())
        for counts in (registry.pages.verdict_counts(LOT), view.counts):
            assert {word: count for word, count in counts.items() if count} == dict(counted)
        wall = wall_view(registry, view, (), translate)
        assert {word: count for word, _, count in wall.verdicts if count} == dict(counted)
        assert all(chip.word == translate(f"verdict.{expected_statuses[chip.serial]}") for chip in wall.chips)
        assert lot_yields(registry, LOT).last_pass.count == view.yields.last_pass.count == counted["pass"]
        # Nothing passes beyond the limit in force, and nothing is judged by another one.
        limit, unit_statuses = lot_limit(registry, LOT), registry.pages.unit_statuses(LOT, list(expected_statuses))
        states = {serial: one.calibration.state for serial, one in unit_statuses.items() if one.calibration is not None}
        assert view.limit_rmse == limit.stated_rmse
        for serial, one in states.items():
            if expected_statuses[serial] in ("pass", "conditional") and one.decision.is_audited:
                assert one.scores.after.rmse <= limit.maximum_rmse, serial
        # Audits are the same number everywhere; one that is set aside counts nowhere.
        audited = {serial for serial, one in states.items() if one.decision.is_audited}
        assert {row.serial for row in view.audited} >= audited
        listed = {row.serial: row.suspect_reason for row in read_lot_status(registry, LOT).audited}
        assert audited <= {serial for serial, suspicion in listed.items() if suspicion is None}
        status = read_lot_status(registry, LOT)
        assert status.counts == registry.pages.verdict_counts(LOT) and status.limit == limit
        ways = {way: {unit.serial for unit in status.on(way)} for way in Disposition}
        assert ways[Disposition.MEASURED] | ways[Disposition.SAMPLED] == {
            serial for serial, word in expected_statuses.items() if word == "pass"
        }
        assert ways[Disposition.MEASURED] <= audited and sum(map(len, ways.values())) == len(statuses["units"])
        # What was released once and is no more is named, whatever took it back.
        history.passed |= ways[Disposition.MEASURED] | ways[Disposition.SAMPLED]
        assert {unit.serial for unit in status.withdrawn} >= {
            s for s in history.passed if expected_statuses[s] != "pass"
        }
        alerts = [alert.values["count"] for alert in lot_alerts(view) if alert.kind == "withdrawn"]
        assert alerts == [len(status.withdrawn)] * bool(status.withdrawn)
        assert all(unit.reasons for unit in (*status.on(Disposition.WAITING), *status.withdrawn))
        decided = status.decided
        if decided is not None:
            build_lot_statement(registry, status, decided)
            assert {audit.serial for audit in decided.qualification.lot_audits} <= audited
            assert set(decided.suspects) == {serial for serial, suspicion in listed.items() if suspicion is not None}
            sampled = {s for s, one in states.items() if expected_statuses[s] == "pass" and not one.decision.is_audited}
            assert sampled <= set(decision_in_force(registry, LOT).released)
        # Files are written for what passes, and for nothing else.
        try:
            exported = set(lot_serials(registry, LOT, ExportOptions()))
        except InputError:
            exported = set()
        assert exported == {serial for serial, word in expected_statuses.items() if word == "pass"}
        read_line(registry, Screen("line"))
    out = tmp_path / "files"
    for serial in sorted(expected_statuses)[:3]:
        code = history.run("export", "--serial", serial, "--format", "blob", "--out", out)
        assert (code == 0) == (expected_statuses[serial] == "pass"), serial


@pytest.mark.parametrize(("seed", "steps"), [(0, 5), *(pytest.param(k, 9, marks=pytest.mark.long) for k in range(31))])
def test_all_surfaces_agree_after_any_history(make_lot, press_unit, registry_url, tmp_path, seed, steps):
    rng = np.random.default_rng(seed)
    folder = make_lot(
        audits=int(rng.integers(0, 12)), limit_N=float(rng.uniform(0.05, 0.3)), day_gain=float(rng.choice([1.0, 1.2]))
    )
    history = History(folder, registry_url, rng, press_unit)
    for _ in range(steps):
        history.step()
        try:
            check(history, tmp_path)
        except AssertionError as error:
            raise AssertionError(f"after {', '.join(history.told)}") from error
