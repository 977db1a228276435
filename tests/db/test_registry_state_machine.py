"""The registry behaves like a plain dictionary with a memory, whatever is done to it in whatever order."""

import itertools
import os
import shutil
import tempfile
import uuid
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
)
from sqlalchemy import Engine, create_engine, text
from sqlalchemy.exc import OperationalError

from softcal.core.errors import InputError
from softcal.core.lot import Lot
from softcal.core.messages.reason import plain
from softcal.core.network.network import Network
from softcal.core.recording import OutputRecording
from softcal.core.unit.state import UnitState
from softcal.db.connection import open_registry
from softcal.db.maintenance.backup import back_up, restore
from softcal.db.repositories import in_use
from softcal.db.repositories.calibrations import CalibrationTables
from tests.unit_states import state_of

pytestmark = pytest.mark.long

ADMIN_URL = os.environ.get("SOFTCAL_TEST_POSTGRESQL", "postgresql+psycopg://postgres@127.0.0.1:5432/postgres")
SERIALS = st.sampled_from(["A1", "A2", "A3"])
LOTS = st.sampled_from(["L1", "L2"])
NUMBERS = st.integers(0, 3)


@cache
def server() -> Engine | None:
    """A server that makes and drops databases; None where none answers."""
    engine = create_engine(ADMIN_URL, isolation_level="AUTOCOMMIT")
    try:
        engine.connect().close()
    except OperationalError:
        return None
    return engine


class RegistryMachine(RuleBasedStateMachine):
    """Every rule is done to the registry and to `self.history`: per serial the numbers of its revisions."""

    moves = True
    """Whether it goes to other files and databases, which takes seconds."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(tempfile.mkdtemp(prefix="softcal-machine-"))
        self.url, self.numbers = f"sqlite:///{self.folder / 'registry.db'}", itertools.count()
        self.registry = open_registry(self.url)
        self.databases: list[str] = []
        self.history: dict[str, list[int]] = {}
        self.units: dict[str, set[str]] = {}
        self.verdicts: dict[tuple[str, str], str] = {}
        self.used: dict[str, dict[str, int]] = {}
        self.lots: dict[str, list[str]] = {}

    @initialize()
    def two_lots(self) -> None:
        network = Network((np.zeros((15, 1)),), (np.zeros(1),), 0.0, 1.0, 0.0, 1.0)
        for lot_id in ("L1", "L2"):
            self.registry.lots.add(Lot(lot_id, "S0", 50.0, limit_rmse=2.0))
            self.units[lot_id] = {"S0"}
        self.network_id = self.registry.networks.add("L1", network, {}, {}, "a" * 64)

    def state(self, serial: str, number: int) -> UnitState:
        return state_of(serial, self.network_id, "c" * 64, number)

    @rule(lot_id=LOTS, serial=SERIALS, number=NUMBERS)
    def calibrate(self, lot_id: str, serial: str, number: int) -> None:
        revision = self.registry.calibrations.add(lot_id, self.state(serial, number))
        self.history.setdefault(serial, []).append(number)
        self.lots.setdefault(serial, []).append(lot_id)
        assert revision == len(self.history[serial])
        self.used.setdefault(serial, {})[lot_id] = revision
        self.units[lot_id].add(serial)
        self.verdicts[lot_id, serial] = "pass"

    @rule(lot_id=LOTS, serial=SERIALS)
    def refuse(self, lot_id: str, serial: str) -> None:
        self.registry.calibrations.refuse(lot_id, serial, "retest", (plain("constant"),))
        self.units[lot_id].add(serial)
        self.verdicts[lot_id, serial] = "retest"

    @rule(lot_id=LOTS, serial=SERIALS, to=st.integers(1, 6))
    def roll_back(self, lot_id: str, serial: str, to: int) -> None:
        numbers, lots = self.history.get(serial, []), self.lots.get(serial, [])
        revision_in_use = self.used.get(serial, {}).get(lot_id)
        is_there = to <= len(numbers) and lots[to - 1] == lot_id
        is_possible = is_there and revision_in_use is not None and numbers[to - 1] != numbers[revision_in_use - 1]
        try:
            revision = self.registry.calibrations.rollback(serial, to, reason="test", lot_id=lot_id)
        except InputError:
            assert not is_possible
            return
        assert is_possible
        numbers.append(numbers[to - 1])
        lots.append(lot_id)
        self.used[serial][lot_id] = revision
        self.verdicts[lot_id, serial] = "pass"

    @rule(lot_id=LOTS, serial=SERIALS, number=NUMBERS)
    def record_again(self, lot_id: str, serial: str, number: int) -> None:
        recording = OutputRecording(serial, np.arange(20) / 50, np.sin(np.arange(20.0) + number), 50.0)
        assert self.registry.recordings.add(lot_id, recording, "unit") == recording.sha256
        self.units[lot_id].add(serial)

    @rule(serial=SERIALS)
    def break_off(self, serial: str) -> None:
        try:
            with self.registry.transaction():
                self.registry.calibrations.add("L1", self.state(serial, 9))
                raise ZeroDivisionError
        except ZeroDivisionError:
            pass

    @rule()
    def open_again(self) -> None:
        self.registry.close()
        self.registry = open_registry(self.url, create=False)

    def new_file(self) -> Path:
        return self.folder / f"{next(self.numbers)}.db"

    @precondition(lambda self: self.moves)
    @rule()
    def back_up_and_restore(self) -> None:
        self.move_to(f"sqlite:///{self.new_file()}")

    @precondition(lambda self: self.moves and not self.databases and server() is not None)
    @rule()
    def move_to_postgresql(self) -> None:
        self.databases.append(f"softcal_test_{uuid.uuid4().hex[:12]}")
        with server().connect() as connection:
            connection.execute(text(f"CREATE DATABASE {self.databases[-1]}"))
        self.move_to(server().url.set(database=self.databases[-1]).render_as_string(hide_password=False))

    def move_to(self, url: str) -> None:
        backup = self.new_file()
        back_up(self.registry.database, backup)
        self.registry.close()
        restore(backup, url)
        self.url, self.registry = url, open_registry(url, create=False)

    @invariant()
    def the_history_is_the_model_s(self) -> None:
        for serial, numbers in self.history.items():
            stored = self.registry.calibrations.history(serial)
            assert [c.state.fit.fitted.unit_map.gain - 1.0 for c in stored] == numbers
            in_use_revisions = {(lot_id, revision) for lot_id, revision in self.used[serial].items()}
            assert {(c.lot_id, c.revision) for c in stored if c.is_current} == in_use_revisions

    @invariant()
    def the_units_are_the_model_s(self) -> None:
        for lot_id, serials in self.units.items():
            verdicts = {unit.serial: unit.verdict for unit in self.registry.lots.units(lot_id)}
            assert verdicts == {serial: self.verdicts.get((lot_id, serial)) for serial in serials}

    def teardown(self) -> None:
        try:
            assert self.registry.verify() == []
        finally:
            self.registry.close()
            shutil.rmtree(self.folder)
            for name in self.databases:
                with server().connect() as connection:
                    connection.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))


TestRegistryMachine = RegistryMachine.TestCase
TestRegistryMachine.settings = settings(
    max_examples=12, stateful_step_count=20, deadline=None, suppress_health_check=list(HealthCheck)
)


class StayingMachine(RegistryMachine):
    """The same without what takes seconds, for many examples."""

    moves = False


def _no_rollback(self, serial, to, **_):
    if not (stored := self.history(serial)):
        raise InputError("there is nothing to roll back")
    return stored[-1].revision


def _first_one_stays(self, lot_id, serial, *rest):
    current = in_use.InUseTable._in_use(self, lot_id, serial)
    return None if current is not None else STATE(self, lot_id, serial, *rest)


STATE = in_use.InUseTable._write_statement
MUTANTS = {
    "a rollback does nothing": ("rollback", _no_rollback),
    "the first map stays in use": ("_write_statement", _first_one_stays),
    "a refusal is forgotten": ("refuse", lambda *_, **__: None),
}


@pytest.mark.parametrize("mutant", MUTANTS)
def test_the_machine_finds_a_registry_that_does_otherwise(
    mutant: str, monkeypatch: pytest.MonkeyPatch, assert_finds_fault: Callable
) -> None:
    monkeypatch.setattr(CalibrationTables, *MUTANTS[mutant])
    assert_finds_fault(StayingMachine)
