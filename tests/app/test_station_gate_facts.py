"""The gate of a real station: closed until certificate and golden unit are in the registry, open after that."""

from datetime import UTC, date, datetime, timedelta

import numpy as np
import pytest

from softcal.app.connect.stations import station_json
from softcal.app.line.station_gate import GateRules, StationGate, check_golden, quarantine
from softcal.app.registry.golden import newest_golden
from softcal.core.errors import InputError
from softcal.core.lot import Lot
from softcal.core.orders import Heartbeat, Order, OrderKind, Progress, RunState, StationState
from softcal.core.quality.gate import RigStatus
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.db.connection import open_registry
from softcal.db.entries import CellCertificate, GoldenRun
from softcal.station.devices.config import ForceConfig, ReadoutConfig, StageConfig, StationConfig

CONFIG = StationConfig(StageConfig("a"), ReadoutConfig("b"), ForceConfig("c", serial="K1"))
NOW = datetime.now(UTC)
WARM = RigStatus(timedelta(hours=1), is_homed=True)


@pytest.fixture
def registry(tmp_path):
    with open_registry(f"sqlite:///{tmp_path / 'r.db'}") as registry:
        yield registry


def golden(registry, passed, at=NOW):
    registry.stations.add_golden_run(GoldenRun("s1", "L1", "G1", at, 0.1, "N", passed, () if passed else ("off",)))


def certify(registry):
    registry.stations.add_certificate(
        CellCertificate("K1", "17", "Lab", date(2020, 1, 1), date(2090, 1, 1), 20.0, 0.02)
    )


def test_the_gate_opens_when_certificate_and_golden_unit_are_there(registry):
    gate = StationGate(registry, "s1", CONFIG, GateRules())
    assert len(gate(OrderKind.UNIT, WARM).reasons) == 2
    certify(registry)
    assert gate(OrderKind.GOLDEN, WARM).is_open
    assert not gate(OrderKind.UNIT, WARM).is_open
    golden(registry, passed=True)
    assert gate(OrderKind.UNIT, WARM).is_open
    assert not gate(OrderKind.UNIT, RigStatus()).is_open  # not warm


def test_a_failed_golden_unit_closes_the_gate_and_quarantines(registry):
    certify(registry)
    golden(registry, True, NOW - timedelta(hours=2))
    queue = registry.order_queue
    queue.place(Order("o1", "s1", OrderKind.UNIT, "A1", created=NOW - timedelta(hours=1)))
    queue.report(Progress("o1", RunState.DONE, recording_sha256="abc"))
    golden(registry, False)
    (why,) = StationGate(registry, "s1", CONFIG, GateRules())(OrderKind.UNIT, WARM).reasons
    assert why.code == "gate.golden_bad"
    assert quarantine(registry, "s1", datetime.now(UTC)) == ("A1",)


@pytest.mark.parametrize(("passed", "why"), [(True, "gate.no_golden"), (False, "gate.golden_bad")])
def test_a_golden_unit_of_a_clock_that_was_a_day_ahead_opens_nothing(registry, passed, why):
    certify(registry)
    golden(registry, passed, NOW + timedelta(days=1))
    gate = StationGate(registry, "s1", CONFIG, GateRules())
    assert [one.code for one in gate(OrderKind.UNIT, WARM).reasons] == [why]
    golden(registry, not passed)
    assert gate(OrderKind.UNIT, WARM).is_open is not passed


def test_no_golden_unit_of_a_clock_that_was_a_day_ahead_corrects_a_sitting(registry):
    registry.lots.add(Lot("L1", "G1", 50.0))
    for at in (NOW, NOW + timedelta(days=1)):
        run = GoldenRun("s1", "L1", "G1", at, 0.1, "N", True, recording_sha256=f"{at.day:064}")
        registry.stations.add_golden_run(run)
    assert newest_golden(registry, "s1", "L1", NOW - timedelta(hours=1)) == f"{NOW.day:064}"


def test_an_override_opens_the_gate_in_spite_of_the_reasons_and_is_audited(registry):
    gate = StationGate(registry, "s1", CONFIG, GateRules())
    with pytest.raises(InputError):
        gate.override("kim", " ")
    gate.override("kim", "certificate is in the post")
    answer = gate(OrderKind.UNIT, WARM)
    assert answer.is_open and answer.reasons
    row = registry.trail.rows()[-1]
    assert (row.action, row.actor, row.reason) == ("override", "kim", "certificate is in the post")


def test_an_override_that_a_clock_a_day_ahead_gave_ends_with_that_clock(registry, monkeypatch):
    class Ahead(datetime):
        @classmethod
        def now(cls, tz=None):
            return datetime.now(tz) + timedelta(days=1)

    gate = StationGate(registry, "s1", CONFIG, GateRules())
    with monkeypatch.context() as patch:
        patch.setattr("softcal.app.line.station_gate.datetime", Ahead)
        gate.override("kim", "certificate is in the post")
        assert gate(OrderKind.UNIT, WARM).is_open
    assert not gate(OrderKind.UNIT, WARM).is_open


def test_a_golden_unit_without_calibration_decides_nothing(registry):
    registry.lots.add(Lot("L1", "A0", 50.0))
    t_s = np.arange(100) / 50
    recording = LabelledRecording(OutputRecording("G1", t_s, np.sin(t_s), 50.0), np.cos(t_s))
    with pytest.raises(InputError, match="G1"):
        check_golden(registry, "s1", recording)


def test_a_failed_check_of_a_clock_that_was_ahead_holds_until_the_next_check(registry):
    certify(registry)
    golden(registry, True, NOW - timedelta(hours=2))
    queue = registry.order_queue
    queue.place(Order("o1", "s1", OrderKind.UNIT, "A1", created=NOW - timedelta(hours=1)))
    queue.report(Progress("o1", RunState.DONE, recording_sha256="abc"))
    golden(registry, False, NOW + timedelta(days=300))
    gate = StationGate(registry, "s1", CONFIG, GateRules())
    assert quarantine(registry, "s1", datetime.now(UTC)) == ("A1",)
    assert [why.code for why in gate(OrderKind.UNIT, WARM).reasons] == ["gate.golden_bad"]
    # The clock was set right, and the golden unit pressed again: whatever the stamp, that check came later.
    golden(registry, True, datetime.now(UTC))
    assert quarantine(registry, "s1", datetime.now(UTC)) == ()
    assert gate(OrderKind.UNIT, WARM).is_open
    assert quarantine(registry, "s1", NOW + timedelta(days=301)) == ()


def test_a_good_check_of_a_clock_that_was_ahead_opens_nothing(registry):
    certify(registry)
    golden(registry, True, NOW + timedelta(hours=3))
    golden(registry, False, NOW - timedelta(minutes=1))
    gate = StationGate(registry, "s1", CONFIG, GateRules())
    assert [why.code for why in gate(OrderKind.UNIT, WARM).reasons] == ["gate.golden_bad"]


def test_units_of_two_lots_with_one_serial_are_held_each_by_its_own_name(registry):
    queue = registry.order_queue
    for number, lot_id in enumerate(("L1", "L2")):
        pressed_at = NOW - timedelta(minutes=30 - number)
        queue.place(Order(f"o{number}", "s1", OrderKind.UNIT, "A1", lot_id, created=pressed_at))
        queue.report(Progress(f"o{number}", RunState.DONE, recording_sha256="abc"))
    golden(registry, False)
    assert quarantine(registry, "s1", datetime.now(UTC)) == ("L1/A1", "L2/A1")


def test_the_last_unit_of_a_station_has_the_lot_that_it_is_of(registry):
    queue = registry.order_queue
    queue.place(Order("o1", "s1", OrderKind.UNIT, "A1", "L1", created=NOW - timedelta(minutes=5)))
    queue.report(Progress("o1", RunState.DONE, verdict="pass"))
    queue.place(Order("o2", "s1", OrderKind.UNIT, "A1", "L2"))
    content = station_json(registry, Heartbeat("s1", StationState.RUNNING, datetime.now(UTC)))
    assert (content["serial"], content["lot"]) == ("A1", "L2")
    assert (content["last_serial"], content["last_lot"]) == ("A1", "L1")
