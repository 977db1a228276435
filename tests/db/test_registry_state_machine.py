"""The registry behaves like a plain dictionary with a memory, whatever is done to it in whatever order."""

import shutil
import tempfile
from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from softcal.core.errors import InputError
from softcal.core.identity import content_sha256
from softcal.core.lot import Lot
from softcal.core.network.network import Network
from softcal.core.recording import OutputRecording
from softcal.core.unit.calibration import CalibrationRecord
from softcal.core.words.reason import plain
from softcal.db.backup import back_up, restore
from softcal.db.connection import open_registry

SERIALS = st.sampled_from(["A1", "A2", "A3"])
LOTS = st.sampled_from(["L1", "L2"])
NUMBERS = st.integers(0, 3)


class RegistryMachine(RuleBasedStateMachine):
    """Every rule is done to the registry and to `self.history`: per serial the numbers of its revisions."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(tempfile.mkdtemp(prefix="softcal-machine-"))
        self.registry = open_registry(f"sqlite:///{self.folder / 'registry.db'}")
        self.history: dict[str, list[int]] = {}
        self.units: dict[str, set[str]] = {}
        self.verdicts: dict[tuple[str, str], str] = {}
        self.used: dict[str, dict[str, int]] = {}
        self.lots: dict[str, list[str]] = {}

    @initialize()
    def two_lots(self) -> None:
        network = Network((np.zeros((15, 1)),), (np.zeros(1),), 0.0, 1.0, 0.0, 1.0)
        for lot_id in ("L1", "L2"):
            self.registry.add_lot(Lot(lot_id, "S0", 50.0))
            self.units[lot_id] = {"S0"}
        self.network_id = self.registry.add_network("L1", network, {}, {}, "a" * 64)

    def record(self, serial: str, number: int) -> CalibrationRecord:
        arrays = {"map.gain": np.array([float(number)])}
        sha256 = content_sha256(arrays, {})
        return CalibrationRecord(
            serial, self.network_id, "affine", sha256, arrays, {}, 0.1, "pass", ("fine",), sha256, sha256
        )

    @rule(lot_id=LOTS, serial=SERIALS, number=NUMBERS)
    def calibrate(self, lot_id: str, serial: str, number: int) -> None:
        revision = self.registry.add_calibration(lot_id, self.record(serial, number))
        self.history.setdefault(serial, []).append(number)
        self.lots.setdefault(serial, []).append(lot_id)
        assert revision == len(self.history[serial])
        self.used.setdefault(serial, {})[lot_id] = revision
        self.units[lot_id].add(serial)
        self.verdicts[lot_id, serial] = "pass"

    @rule(lot_id=LOTS, serial=SERIALS)
    def refuse(self, lot_id: str, serial: str) -> None:
        self.registry.add_refusal(lot_id, serial, "retest", (plain("constant"),))
        self.units[lot_id].add(serial)
        self.verdicts[lot_id, serial] = "retest"

    @rule(lot_id=LOTS, serial=SERIALS, to=st.integers(1, 6))
    def roll_back(self, lot_id: str, serial: str, to: int) -> None:
        numbers, lots = self.history.get(serial, []), self.lots.get(serial, [])
        used = self.used.get(serial, {}).get(lot_id)
        is_there = to <= len(numbers) and lots[to - 1] == lot_id
        is_possible = is_there and used is not None and numbers[to - 1] != numbers[used - 1]
        try:
            revision = self.registry.rollback(serial, to, reason="test", lot_id=lot_id)
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
        assert self.registry.add_recording(lot_id, recording, "unit") == recording.sha256
        self.units[lot_id].add(serial)

    @rule(serial=SERIALS)
    def break_off(self, serial: str) -> None:
        try:
            with self.registry.transaction():
                self.registry.add_calibration("L1", self.record(serial, 9))
                raise ZeroDivisionError
        except ZeroDivisionError:
            pass

    @rule()
    def open_again(self) -> None:
        self.registry.close()
        self.registry = open_registry(f"sqlite:///{self.folder / 'registry.db'}", create=False)

    @precondition(lambda self: not (self.folder / "backup.db").exists())
    @rule()
    def back_up_and_restore(self) -> None:
        back_up(self.registry.database, self.folder / "backup.db")
        self.registry.close()
        (self.folder / "registry.db").unlink()
        restore(self.folder / "backup.db", f"sqlite:///{self.folder / 'registry.db'}")
        self.registry = open_registry(f"sqlite:///{self.folder / 'registry.db'}", create=False)

    @invariant()
    def the_history_is_the_model_s(self) -> None:
        for serial, numbers in self.history.items():
            stored = self.registry.history(serial)
            assert [float(c.record.arrays["map.gain"][0]) for c in stored] == numbers
            used = {(lot_id, revision) for lot_id, revision in self.used[serial].items()}
            assert {(c.lot_id, c.revision) for c in stored if c.is_current} == used

    @invariant()
    def the_units_are_the_model_s(self) -> None:
        for lot_id, serials in self.units.items():
            found = {unit.serial: unit.verdict for unit in self.registry.units(lot_id)}
            assert found == {serial: self.verdicts.get((lot_id, serial)) for serial in serials}

    def teardown(self) -> None:
        assert self.registry.verify() == []
        self.registry.close()
        shutil.rmtree(self.folder)


TestRegistryMachine = RegistryMachine.TestCase
TestRegistryMachine.settings = settings(
    max_examples=12, stateful_step_count=20, deadline=None, suppress_health_check=list(HealthCheck)
)
