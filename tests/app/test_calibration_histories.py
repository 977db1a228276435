"""Batches, lines, changes of files, restores, synchronisations and rollbacks in any order: what is in use is what a
simple model of events says. The fit is faked, everything else is real."""

import contextlib
import itertools
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from softcal.app.batch import lot_work
from softcal.app.batch.lot_work import BatchConfig, Callbacks, LotWork
from softcal.app.batch.unit_work import ChunkOutcome, UnitOutcome
from softcal.app.calibration.lot_context import StoredInputs
from softcal.app.calibration.unit_calibration import Calibrated, ExistingCalibration, LotContext, Refusal
from softcal.app.files.lot_folder import LotFolder
from softcal.core.errors import InputError
from softcal.core.identity import content_sha256
from softcal.core.lot import Lot
from softcal.core.messages.reason import plain
from softcal.core.network.network import Network
from softcal.core.unit.method import Method
from softcal.core.unit.state import UnitState
from softcal.core.unit.verdict import Verdict
from softcal.db.connection import open_registry
from softcal.db.maintenance.backup import back_up, restore
from softcal.db.maintenance.sync import synchronise
from softcal.db.repositories.calibrations import CalibrationTables
from softcal.db.repositories.registry_base import RegistrySettings
from tests.unit_states import state_of

pytestmark = pytest.mark.long

SERIALS, SIDES = ("A1", "A2"), ("station", "centre")
BAD = 0
LOT = Lot("L1", "S0", 50.0, limit_rmse=2.0)
NETWORK = Network((np.zeros((15, 1)),), (np.zeros(1),), 0.0, 1.0, 0.0, 1.0)
LOT_CONTEXT = LotContext((SimpleNamespace(network=NETWORK, method=Method()),))


def input_of(serial: str, number: int) -> str:
    return content_sha256({}, {"serial": serial, "number": number})


def unit_state(serial: str, number: int) -> UnitState:
    return state_of(serial, NETWORK.id, "c" * 64, number)


def fake_work(shared, chunk):
    """A file holds one number; its map is that number, and 0 cannot be calibrated."""
    units = []
    for task in chunk.tasks:
        number = int(task.recording.content)
        if number == BAD:
            result = Refusal(Verdict.RETEST, plain("bad"))
        elif input_of(task.serial, number) in task.existing:
            result = ExistingCalibration(input_of(task.serial, number))
        else:
            result = Calibrated(unit_state(task.serial, number), input_of(task.serial, number))
        units.append(UnitOutcome(task.item_id, task.serial, result))
    return ChunkOutcome(tuple(units), 0.0)


@dataclass(frozen=True)
class Event:
    """A statement about a unit (`number` of the map), or a refusal (`number` None).

    Args:
        at: order in time.
        parents: events it was made upon.
        asked: the input that asked for it; None where a person decided.
        work: the file that asked for it; None at a line.
    """

    at: int
    number: int | None
    parents: frozenset["Event"]
    asked: int | None
    work: int | None


class OneAnswerMachine(RuleBasedStateMachine):
    """Two registries, each with a folder of files; the model knows which events each has seen of each unit."""

    @initialize()
    def two_registries(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="softcal-machine-"))
        self.names, self.ticks = itertools.count(), itertools.count(1)
        self.events = {side: {serial: set() for serial in SERIALS} for side in SIDES}
        self.files = {side: {} for side in SIDES}
        self.broken_off: set[str] = set()
        self.registries = {}
        for side in SIDES:
            (self.folder / side).mkdir()
            registry = self.registries[side] = self.opened(self.folder / f"{side}.db")
            registry.lots.add(LOT)
            registry.networks.add("L1", NETWORK, {}, {}, "a" * 64)

    def opened(self, path: Path):
        start = datetime(2026, 5, 4, tzinfo=UTC)
        if not hasattr(self, "clock"):
            seconds = itertools.count()
            self.clock = lambda: start + timedelta(seconds=next(seconds))
        return open_registry(f"sqlite:///{path}", RegistrySettings(clock=self.clock))

    def heads(self, side: str, serial: str) -> set[Event]:
        numbered = {event for event in self.events[side][serial] if event.number is not None}
        return numbered - {parent for event in numbered for parent in event.parents}

    def state(self, side: str, serial: str, number: int, asked: int | None, work: int | None) -> None:
        event = Event(next(self.ticks), number, frozenset(self.heads(side, serial)), asked, work)
        self.events[side][serial].add(event)

    def store(self, side: str, serial: str, number: int, work: int | None) -> None:
        """What a batch or a line does with a recording."""
        events, heads = self.events[side][serial], self.heads(side, serial)
        # Whoever asked for a number first has made its map.
        if number not in {event.asked for event in events}:
            self.state(side, serial, number, number, work)
            return
        if len({head.number for head in heads}) > 1:
            return
        last = max((event for event in events if event.asked is not None), key=lambda event: event.at)
        refused = max((event.at for event in events if event.number is None), default=0)
        is_again = last.asked == number and refused < last.at
        if not (is_again and work in (None, last.work)):
            self.state(side, serial, next(iter(heads)).number if is_again else number, number, work)

    @rule(side=st.sampled_from(SIDES), changes=st.dictionaries(st.sampled_from(SERIALS), st.integers(0, 2)))
    def batch(self, side: str, changes: dict[str, int]) -> None:
        for serial, number in changes.items():
            (self.folder / side / f"{serial}.csv").write_text(str(number))
            self.files[side][serial] = number
        files = self.files[side]
        paths = {serial: self.folder / side / f"{serial}.csv" for serial in files}
        folder = LotFolder(lot=LOT, root=self.folder / side, source_path=self.folder, unit_paths=paths, audit_paths={})
        worked: list[str] = []

        def counting(shared, chunk):
            worked.extend(task.serial for task in chunk.tasks)
            return fake_work(shared, chunk)

        undecided = [serial for serial in files if self.is_to_be_worked_on(side, serial)]
        with mock.patch.object(lot_work, "work_on", counting):
            work = self.work(folder, side, BatchConfig(), Callbacks())
            work.run()
            results = work.unit_results(list(paths))
        assert set(undecided) <= set(worked)
        # A batch that was broken off leaves work in the queue that nobody may need any more.
        assert side in self.broken_off or sorted(worked) == sorted(undecided)
        for serial in files:
            self.answer_batch(side, serial)
        assert {serial: result.verdict for serial, result in results.items()} == {
            s: self.verdict(side, s) for s in files
        }

    def work(self, folder: LotFolder, side: str, config: BatchConfig, callbacks: Callbacks) -> LotWork:
        registry = self.registries[side]
        return LotWork(
            folder, registry, LOT_CONTEXT, StoredInputs(registry, LOT.id, list(folder.unit_paths)), config, callbacks
        )

    def is_to_be_worked_on(self, side: str, serial: str) -> bool:
        """Whether a batch has to read the unit's file: nothing that is known answers it."""
        number, events = self.files[side][serial], self.events[side][serial]
        was_calibrated = any(event.work == number and event.asked == number for event in events)
        return self.newest_work(side, serial) != number and not was_calibrated

    def newest_work(self, side: str, serial: str) -> int | None:
        """The file that the newest result answers."""
        results = [event for event in self.events[side][serial] if event.number is None or event.asked is not None]
        newest = max(results, key=lambda event: event.at, default=None)
        return None if newest is None else newest.work

    def answer_batch(self, side: str, serial: str) -> None:
        """What a batch that comes to a unit does."""
        number = self.files[side][serial]
        if self.newest_work(side, serial) != number:
            if number == BAD:
                self.events[side][serial].add(Event(next(self.ticks), None, frozenset(), None, BAD))
            else:
                self.store(side, serial, number, number)

    @rule(side=st.sampled_from(SIDES), number=st.integers(0, 2))
    def batch_that_is_broken_off(self, side: str, number: int) -> None:
        """Every file is another one; the batch ends after the first unit it keeps."""
        self.broken_off.add(side)
        files = self.files[side]
        for serial in SERIALS:
            (self.folder / side / f"{serial}.csv").write_text(str(number))
            files[serial] = number
        paths = {serial: self.folder / side / f"{serial}.csv" for serial in files}
        folder = LotFolder(lot=LOT, root=self.folder / side, source_path=self.folder, unit_paths=paths, audit_paths={})
        stored_serials: list[str] = []

        def end(result) -> None:
            stored_serials.append(result.serial)
            raise KeyboardInterrupt

        # What was asked for by the same file before is put into use before anything is queued.
        asked_before = [s for s in files if any(e.work == number and e.asked == number for e in self.events[side][s])]
        with mock.patch.object(lot_work, "work_on", fake_work), contextlib.suppress(KeyboardInterrupt):
            self.work(folder, side, BatchConfig(chunk=1), Callbacks(on_unit=end)).run()
        for serial in (*asked_before, *stored_serials):
            self.answer_batch(side, serial)

    @rule(side=st.sampled_from(SIDES), serial=st.sampled_from(SERIALS), number=st.integers(1, 2))
    def press(self, side: str, serial: str, number: int) -> None:
        registry, input_id = self.registries[side], input_of(serial, number)
        if registry.calibrations.find(serial, input_id, lot_id="L1") is None:
            registry.calibrations.add("L1", unit_state(serial, number), input_sha256=input_id)
        else:
            registry.calibrations.put_in_use("L1", serial, input_id, "line")
        self.store(side, serial, number, None)

    @rule(side=st.sampled_from(SIDES), serial=st.sampled_from(SERIALS), which=st.integers(0, 5))
    def roll_back(self, side: str, serial: str, which: int) -> None:
        if not self.heads(side, serial):
            return
        history = self.registries[side].calibrations.history(serial)
        old = history[which % len(history)]
        number = round(old.state.fit.fitted.unit_map.gain - 1)
        numbers = {head.number for head in self.heads(side, serial)}
        try:
            self.registries[side].calibrations.rollback(serial, old.revision, origin=old.origin, reason="test")
        except InputError:
            assert numbers == {number}
            return
        assert numbers != {number}
        self.state(side, serial, number, None, None)

    @rule()
    def sync(self) -> None:
        report = synchronise(*self.registries.values())
        for serial in SERIALS:
            events = self.events["station"][serial] | self.events["centre"][serial]
            self.events["station"][serial], self.events["centre"][serial] = set(events), set(events)
        parted = [serial for serial in SERIALS if len({head.number for head in self.heads("centre", serial)}) > 1]
        assert len(report.conflicts) == len(parted)

    @rule(side=st.sampled_from(SIDES))
    def restore(self, side: str) -> None:
        backup, path = (self.folder / f"{next(self.names)}.db" for _ in range(2))
        back_up(self.registries[side].database, backup)
        self.registries[side].close()
        restore(backup, f"sqlite:///{path}")
        self.registries[side] = self.opened(path)

    def verdict(self, side: str, serial: str) -> str | None:
        heads, events = self.heads(side, serial), self.events[side][serial]
        if not events:
            return None
        is_refused = max(events, key=lambda event: event.at).number is None
        return "retest" if is_refused or len({head.number for head in heads}) > 1 else "pass"

    @invariant()
    def there_is_one_answer(self) -> None:
        for side, registry in getattr(self, "registries", {}).items():
            listed = {unit.serial: unit.verdict for unit in registry.lots.units("L1")}
            for serial in SERIALS:
                assert listed.get(serial) == self.verdict(side, serial)
                numbers = {head.number for head in self.heads(side, serial)}
                try:
                    numbers_in_use = {round(registry.calibrations.get(serial).state.fit.fitted.unit_map.gain - 1)}
                except InputError:
                    assert len(numbers) != 1
                else:
                    assert numbers_in_use == numbers

    def teardown(self) -> None:
        for registry in getattr(self, "registries", {}).values():
            assert registry.verify() == []
            registry.close()
        if hasattr(self, "folder"):
            shutil.rmtree(self.folder)


TestOneAnswerMachine = OneAnswerMachine.TestCase
TestOneAnswerMachine.settings = settings(
    max_examples=6, stateful_step_count=20, deadline=None, suppress_health_check=list(HealthCheck)
)


MUTANTS = {
    "what was asked for again is not put in use": ("put_in_use", lambda *_, **__: True),
    "what was asked for again is never found": ("put_in_use", lambda *_, **__: False),
    "what is decided is worked on again": ("decided_works", lambda *_, **__: {}),
    "a refusal is forgotten": ("refuse", lambda *_, **__: None),
}


@pytest.mark.parametrize("mutant", MUTANTS)
def test_the_machine_finds_a_registry_that_does_otherwise(
    mutant: str, monkeypatch: pytest.MonkeyPatch, assert_finds_fault: Callable
) -> None:
    monkeypatch.setattr(CalibrationTables, *MUTANTS[mutant])
    assert_finds_fault(OneAnswerMachine)
