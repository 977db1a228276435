"""The gate of a real station: closed until certificate and golden unit are in the registry, open after that."""

from datetime import UTC, date, datetime, timedelta

import numpy as np
import pytest

from softcal.app.workflow.station_gate import GateRules, check_golden, gate_from_registry, quarantine
from softcal.core.errors import InputError
from softcal.core.lot import Lot
from softcal.core.orders import Order, OrderKind, Progress, RunState
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.station_gate import Override
from softcal.db.connection import open_registry
from softcal.db.entries import CellCertificate, GoldenRun
from softcal.station.config import ForceConfig, ReadoutConfig, StageConfig, StationConfig

CONFIG = StationConfig(StageConfig("a"), ReadoutConfig("b"), ForceConfig("c", serial="K1"))
NOW = datetime.now(UTC)
LONG_AGO = NOW - timedelta(days=1)


@pytest.fixture
def registry(tmp_path):
    with open_registry(f"sqlite:///{tmp_path / 'r.db'}") as registry:
        yield registry


def golden(registry, passed, at=NOW):
    registry.add_golden_run(GoldenRun("s1", "G1", at, 0.1, "N", passed, () if passed else ("off",)))


def certify(registry):
    registry.add_certificate(CellCertificate("K1", "17", "Lab", date(2020, 1, 1), date(2090, 1, 1), 20.0, 0.02))


def test_the_gate_opens_when_certificate_and_golden_unit_are_there(registry):
    gate = gate_from_registry(registry, "s1", CONFIG, LONG_AGO, GateRules())
    assert len(gate(OrderKind.UNIT).reasons) == 2
    certify(registry)
    assert gate(OrderKind.GOLDEN).is_open
    assert not gate(OrderKind.UNIT).is_open
    golden(registry, passed=True)
    assert gate(OrderKind.UNIT).is_open


def test_a_failed_golden_unit_closes_the_gate_and_quarantines(registry):
    certify(registry)
    golden(registry, True, NOW - timedelta(hours=2))
    queue = registry.order_queue
    queue.place(Order("o1", "s1", OrderKind.UNIT, "A1", created=NOW - timedelta(hours=1)))
    queue.report(Progress("o1", RunState.DONE, recording_sha256="abc"))
    golden(registry, False)
    assert (
        "outside its control limits"
        in gate_from_registry(registry, "s1", CONFIG, LONG_AGO, GateRules())(OrderKind.UNIT).reasons[0]
    )
    assert quarantine(registry, "s1", datetime.now(UTC)) == ("A1",)


def test_an_override_opens_the_gate_in_spite_of_the_reasons(registry):
    override = Override("kim", "certificate is in the post", NOW + timedelta(hours=1))
    gate = gate_from_registry(registry, "s1", CONFIG, LONG_AGO, GateRules(), override)(OrderKind.UNIT)
    assert gate.is_open and gate.reasons


def test_a_golden_unit_without_calibration_cannot_judge(registry):
    registry.add_lot(Lot("L1", "A0", 50.0))
    t_s = np.arange(100) / 50
    recording = LabelledRecording(OutputRecording("G1", t_s, np.sin(t_s), 50.0), np.cos(t_s))
    with pytest.raises(InputError, match="G1"):
        check_golden(registry, "s1", recording)
