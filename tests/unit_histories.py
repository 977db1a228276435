"""Histories of a lot by all acts, at two stations with a sync: what is released passes on every surface, an act changes
what its preview named, and the order of independent acts changes nothing. Fits are given, everything else is real."""

import itertools
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, seed, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule, run_state_machine_as_test

from softcal.app.calibration.audit import draw_plan, update_lot
from softcal.app.calibration.changes import carry_out, change_limit, preview
from softcal.app.calibration.lot_context import store_result
from softcal.app.calibration.redecision import confirm, redecide, redecide_stale
from softcal.app.calibration.release import decide_lot, read_lot_status, roll_back
from softcal.app.calibration.unit_calibration import Calibrated
from softcal.app.export.certificates.lot_statement import build_lot_statement
from softcal.app.registry.listing import unit_json
from softcal.app.registry.trimmed import store_trim
from softcal.app.rest.v1 import UnitAnswer
from softcal.core.errors import InputError, RegistryError
from softcal.core.identity import content_sha256
from softcal.core.lot import Lot
from softcal.core.maps.affine_map import AffineMap
from softcal.core.maps.interface import Anchors, map_sha256
from softcal.core.network.network import Network
from softcal.core.quality.audit_plan import AuditConfig
from softcal.core.quality.lot_status import Disposition
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.fit import FittedMap
from softcal.core.unit.health import OutputLimits
from softcal.core.unit.state import UnitState
from softcal.core.unit.uncertainty import ErrorForecast
from softcal.core.unit.verdict import Limit
from softcal.db.connection import open_registry
from softcal.db.maintenance.sync import synchronise
from softcal.db.registry import Registry
from softcal.db.repositories.registry_base import RegistrySettings
from tests.unit_states import fit_of, interval

LOT = Lot("L1", "S0", 50.0, limit_rmse=0.5)
UNITS, AUDITED, SIDES = 12, 10, ("station", "centre")
SERIALS = [f"U{number:02d}" for number in range(UNITS)]
ONE_TAP = np.eye(15)[:, -1:]
NETWORK = Network((ONE_TAP,), (np.zeros(1),), 0.5, 0.1, 0.0, 1.0)
LOAD_N = 1.5 - 1.5 * np.cos(np.linspace(0, 8 * np.pi, 400))
START = datetime(2026, 5, 4, tzinfo=UTC)
unit_of, side_of = st.sampled_from(SERIALS), st.sampled_from(SIDES)


def recording_of(serial: str, gain: float = 1.0, shift: int = 0) -> LabelledRecording:
    """A recording of one unit: outputs rise by 0.1 V/N, times its gain."""
    load = np.roll(LOAD_N, shift)
    output = OutputRecording(serial, np.arange(len(load)) / 50.0, 0.5 + 0.1 * gain * load, 50.0)
    return LabelledRecording(output, load)


def calibrated(registry: Registry, serial: str, number: int, rmse_N: float = 0.1) -> Calibrated:
    """A fit of a recording of its own, whose map is a little off: by its number."""
    sha256 = registry.recordings.add(LOT.id, recording_of(serial, shift=number).unlabelled, "unit")
    unit_map = AffineMap(1.0 + 0.01 * number, 0.0)
    fitted = FittedMap(unit_map, interval(), OutputLimits(-np.inf, np.inf, 100))
    forecast = ErrorForecast(rmse_N, rmse_N / 2, 2 * rmse_N)
    others = {"fitted": fitted, "map_sha256": map_sha256(unit_map), "forecast": forecast}
    state = UnitState(fit=fit_of(serial, NETWORK.id, sha256, number, **others), limit=Limit("N", 0.5))
    return Calibrated(state, content_sha256({}, {serial: number}))


def batch(registry: Registry, numbers: dict[str, int]) -> None:
    with registry.transaction():
        for serial, number in numbers.items():
            store_result(registry, LOT.id, serial, calibrated(registry, serial, number), "batch")
        decide_lot(registry, LOT.id)
        update_lot(registry, LOT.id)


def bring_audit(registry: Registry, serial: str, gain: float, shift: int) -> None:
    with registry.transaction():
        registry.recordings.add(LOT.id, recording_of(serial, gain, shift), "audit")
        redecide(registry, [LOT.id])


def trim_unit(registry: Registry, serial: str, gain: float) -> None:
    loads = np.array([0.0, 2.5])
    stored = registry.calibrations.get(serial, lot_id=LOT.id)
    store_trim(registry, stored, Anchors(0.5 + 0.1 * gain * loads, loads))


def states(registry: Registry) -> dict[str, tuple[str | None, str | None]]:
    """Return verdict and state of every unit."""
    return {u.serial: (u.verdict, u.state_sha256) for u in registry.lots.units(LOT.id) if u.role == "target"}


def make_registries(folder: Path) -> None:
    """Put a lot whose sample was drawn, then measured and released, into the registries of both sides."""
    ticks = itertools.count()
    clock = RegistrySettings(clock=lambda: START + timedelta(seconds=next(ticks)))
    first, second = (open_registry(f"sqlite:///{folder / side}.db", clock) for side in SIDES)
    with first, second:
        first.lots.add(LOT)
        trained_on = {"source_recording_sha256": first.recordings.add(LOT.id, recording_of("S0"), "source")}
        first.networks.add(LOT.id, NETWORK, {}, trained_on, "a" * 64)
        batch(first, dict.fromkeys(SERIALS, 0))
        plan = draw_plan(first, LOT.id, AuditConfig(random=AUDITED)).plan
        rng = np.random.default_rng(0)
        for serial in plan.random:
            first.recordings.add(LOT.id, recording_of(serial, 1 + 0.02 * rng.normal(), 3), "audit")
        redecide(first, [LOT.id])
        decide_lot(first, LOT.id)
        update_lot(first, LOT.id)
        assert read_lot_status(first, LOT.id).on(Disposition.SAMPLED), "units are released by sample"
        synchronise(first, second)


class UnitHistories(RuleBasedStateMachine):
    """One history: two registries that begin alike."""

    template: Path
    histories = 0
    counts = Counter[str]()
    """Acts by name, those that were refused under `NAME refused`."""

    @initialize()
    def begin(self) -> None:
        type(self).histories += 1
        self.folder = Path(tempfile.mkdtemp(prefix="softcal-histories-"))
        ticks = itertools.count(86_400)
        clock = RegistrySettings(clock=lambda: START + timedelta(seconds=next(ticks)))
        self.registries, self.touched = {}, set[str]()
        for side in SIDES:
            shutil.copy(self.template / f"{side}.db", self.folder)
            self.registries[side] = open_registry(f"sqlite:///{self.folder / side}.db", clock)

    def teardown(self) -> None:
        for registry in self.registries.values():
            registry.close()
        shutil.rmtree(self.folder)

    def act(self, name: str, side: str, act: Callable[[], object], only: str | None = None) -> None:
        """Do an act as its preview said; one that is refused changes nothing."""
        registry = self.registries[side]
        before = states(registry)
        self.touched.add(side)
        try:
            change = preview(registry, LOT.id, act)
        except (InputError, RegistryError):
            self.counts[f"{name} refused"] += 1
            assert states(registry) == before, "a refused act changed something"
            return
        self.counts[name] += 1
        result = carry_out(registry, LOT.id, act)
        assert [(one.serial, one.verdict, one.next_verdict) for one in result.changed] == [
            (one.serial, one.verdict, one.next_verdict) for one in change.changed
        ]
        after = states(registry)
        announced = {one.serial for one in change.changed}
        assert {serial for serial in after if after[serial][0] != before[serial][0]} == announced
        if only is not None:
            assert {serial for serial in after if after[serial] != before[serial]} <= {only}, "another unit changed"

    @rule(side=side_of, numbers=st.dictionaries(unit_of, st.integers(0, 3), min_size=1, max_size=3))
    def batch(self, side: str, numbers: dict[str, int]) -> None:
        self.act("batch", side, partial(batch, self.registries[side], numbers))

    @rule(side=side_of, serial=unit_of, gain=st.sampled_from([0.98, 1.0, 1.03, 1.4, 5.0]), shift=st.integers(0, 50))
    def audit(self, side: str, serial: str, gain: float, shift: int) -> None:
        self.act("audit", side, partial(bring_audit, self.registries[side], serial, gain, shift))

    @rule(side=side_of, serial=unit_of, gain=st.sampled_from([0.9, 1.0, 1.05, 3.0]))
    def trim(self, side: str, serial: str, gain: float) -> None:
        self.act("trim", side, partial(trim_unit, self.registries[side], serial, gain), serial)

    @rule(side=side_of, rmse=st.sampled_from([None, 0.05, 0.3, 0.5, 2.0]))
    def limit(self, side: str, rmse: float | None) -> None:
        self.act("limit", side, partial(change_limit, self.registries[side], LOT.id, rmse, reason="drawn"))

    @rule(side=side_of, serial=unit_of)
    def confirm(self, side: str, serial: str) -> None:
        registry = self.registries[side]
        if not any(unit.suspect_reason for unit in read_lot_status(registry, LOT.id).audited):
            self.act("audit", side, partial(bring_audit, registry, serial, 5.0, 7))
        suspects = [unit.serial for unit in read_lot_status(registry, LOT.id).audited if unit.suspect_reason]
        chosen = suspects[0] if suspects else serial
        self.act("confirm", side, partial(confirm, registry, LOT.id, chosen, reason="pressed again"))

    @rule(side=side_of)
    def release(self, side: str) -> None:
        self.act("release", side, partial(decide_lot, self.registries[side], LOT.id))

    @rule(side=side_of, serial=unit_of, back=st.integers(1, 3))
    def roll_back(self, side: str, serial: str, back: int) -> None:
        registry = self.registries[side]
        revisions = registry.calibrations.history(serial, LOT.id)
        old = revisions[max(len(revisions) - 1 - back, 0)]
        which = {"reason": "drawn", "lot_id": LOT.id, "origin": old.origin}
        self.act("roll back", side, partial(roll_back, registry, serial, old.revision, **which), serial)

    @rule(side=side_of, count=st.integers(1, UNITS))
    def draw(self, side: str, count: int) -> None:
        config = AuditConfig(random=count, seed=count)
        self.act("draw", side, partial(draw_plan, self.registries[side], LOT.id, config, reason="another sample"))

    @rule()
    def sync(self) -> None:
        here, there = self.registries.values()
        self.touched.update(SIDES)
        self.counts["sync"] += 1
        synchronise(here, there)
        for registry in (here, there):
            redecide_stale(registry)

    @rule(
        side=side_of, units=st.lists(unit_of, min_size=2, max_size=2, unique=True), gain=st.sampled_from([0.95, 1.05])
    )
    def independent_acts_in_either_order(self, side: str, units: list[str], gain: float) -> None:
        registry = self.registries[side]
        first, second = units
        revision = registry.calibrations.history(second, LOT.id)[0]
        which = {"reason": "drawn", "lot_id": LOT.id, "origin": revision.origin}
        acts = (
            partial(trim_unit, registry, first, gain),
            partial(roll_back, registry, second, revision.revision, **which),
        )
        ends = [end for order in (acts, acts[::-1]) if (end := after_all(registry, order)) is not None]
        self.counts["two acts in either order" if ends else "two acts in either order refused"] += 1
        assert len(ends) != 1 and ends[:1] == ends[1:], "the order of two acts changed how they end"

    @invariant()
    def what_is_released_passes_on_every_surface(self) -> None:
        for side in sorted(getattr(self, "touched", ())):
            with self.registries[side].database.reading():
                check_surfaces(self.registries[side])
        self.touched = set()


def check_surfaces(registry: Registry) -> None:
    """Assert that every list of released units has those that pass, and no other."""
    units = [unit for unit in registry.lots.units(LOT.id) if unit.role == "target"]
    unit_statuses = registry.pages.unit_statuses(LOT.id, SERIALS)
    words = {serial: one.verdict for serial, one in unit_statuses.items()}
    decided = {serial: one.state.verdict for serial, one in unit_statuses.items() if one.state is not None}
    assert decided == {serial: words[serial] for serial in decided}
    listed = {unit.serial: unit_json(unit) for unit in units}
    assert {serial: row["verdict"] for serial, row in listed.items()} == words
    assert {serial: UnitAnswer.model_validate(row).verdict for serial, row in listed.items()} == words
    for serial, one in unit_statuses.items():
        assert one.state is None or {name: listed[serial][name] for name in one.errors} == one.errors
    passing = {serial for serial, word in words.items() if word == "pass"}
    standing = read_lot_status(registry, LOT.id)
    assert set(standing.to_json()["released"]) == passing
    assert {unit.serial for way in (Disposition.MEASURED, Disposition.SAMPLED) for unit in standing.on(way)} == passing
    if standing.decided is not None:
        facts = build_lot_statement(registry, standing, standing.decided)
        by_sample = {serial for serial in passing if not unit_statuses[serial].is_audited}
        assert by_sample <= set(facts.decided.released)


class _RolledBack(Exception):  # noqa: N818 - no error: it ends a transaction
    pass


def after_all(registry: Registry, acts: tuple[Callable[[], object], ...]) -> object:
    """Return how acts in this order end, None where one is refused; nothing is kept."""
    end = None
    try:
        with registry.transaction():
            for act in acts:
                act()
            end = states(registry)
            raise _RolledBack
    except (_RolledBack, InputError, RegistryError):
        return end


def run_histories(template: Path, histories: int, steps: int, first: int = 0) -> int:
    """Run so many histories from the registries of a folder; return how many held what they promise."""
    UnitHistories.template, UnitHistories.histories = template, 0
    checks = list(HealthCheck)
    options = settings(max_examples=histories, stateful_step_count=steps, deadline=None, suppress_health_check=checks)
    run_state_machine_as_test(seed(first)(UnitHistories), settings=settings(options, database=None))
    return UnitHistories.histories
