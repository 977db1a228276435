"""The resident service as a line uses it: source, units, golden unit, faults and stops, through the registry alone."""

import threading
from contextlib import contextmanager
from datetime import UTC, date, datetime
from functools import partial

import pytest
from sqlalchemy import update

from softcal.app.line.serve import Serving, serve
from softcal.app.line.station_gate import RIG_ONLY, GateRules
from softcal.core.errors import InputError
from softcal.core.messages.reason import reason
from softcal.core.network.config import NetworkConfig
from softcal.core.orders import Order, OrderKind, RunState, StationState
from softcal.db.connection import open_registry
from softcal.db.entries import CellCertificate
from softcal.db.schema.tables import heartbeats
from tests.wait import wait_until

SMALL = NetworkConfig(hidden=(12, 6), max_epochs=12)
SHORT = {"speed": 1000.0, "source_s": 30.0, "unit_s": 12.0, "network": SMALL}


class Line:
    """A served station and the one who orders from it."""

    def __init__(self, registry, serving, folder):
        self.registry, self.queue = registry, registry.order_queue
        self.is_wanted, self.count, self.error = True, 0, None
        self.thread = threading.Thread(target=self._serve, args=(serving, folder))
        self.thread.start()
        self.wait_for(lambda beat: beat.state in (StationState.READY, StationState.CLOSED))

    def _serve(self, serving, folder):
        try:
            serve(self.registry, serving, folder / "spool", lambda: self.is_wanted)
        except InputError as error:
            self.error = error

    def wait_for(self, is_so):
        heartbeat = partial(self.queue.heartbeat, "s1")
        return wait_until(
            lambda: (station_heartbeat := heartbeat()) and is_so(station_heartbeat) and station_heartbeat, heartbeat
        )

    def place_order(self, kind, serial="", reason=""):
        self.count += 1
        self.queue.place(Order(f"o{self.count}", "s1", OrderKind(kind), serial, "L1", "kim", reason))
        return f"o{self.count}"

    def order(self, kind, serial="", reason=""):
        return self.ended(self.place_order(kind, serial, reason))

    def ended(self, order_id):
        progress = partial(self.queue.progress, order_id)
        wait_until(lambda: not progress().state.is_active, progress)
        return progress()

    def end(self):
        self.is_wanted = False
        self.thread.join(60)
        assert not self.thread.is_alive()


@contextmanager
def served(tmp_path, **changes):
    with open_registry(f"sqlite:///{tmp_path / 'r.db'}") as registry:
        line = Line(registry, Serving("s1", simulated_seed=5, **(SHORT | {"rules": RIG_ONLY} | changes)), tmp_path)
        try:
            yield line
        finally:
            line.end()


@pytest.fixture(scope="module")
def line(tmp_path_factory):
    with served(tmp_path_factory.mktemp("line")) as line:
        order = line.order("source", "A0")
        assert (order.state, order.message[0].code) == (RunState.DONE, "run.trained"), order.text
        yield line


def test_a_source_begins_its_lot_and_trains_its_network(line):
    lot = line.registry.lots.get("L1")
    assert (lot.source, lot.sample_rate_Hz) == ("A0", 50.0)
    assert [entry.lot_id for entry in line.registry.networks.all()] == ["L1"]


def test_a_unit_gets_its_verdict_in_its_order_and_in_the_registry(line):
    order = line.order("unit", "A1")
    assert order.state is RunState.DONE and order.text
    assert order.verdict in ("pass", "conditional", "fail", "retest")
    (unit,) = [unit for unit in line.registry.lots.units("L1") if unit.serial == "A1"]
    assert (unit.verdict, unit.reasons) == (order.verdict, order.message)
    assert line.registry.recordings.get(order.recording_sha256).serial == "A1"


@pytest.mark.long
def test_a_unit_pressed_again_gets_another_revision_with_its_reason(line):
    line.order("unit", "A2")
    line.order("unit", "A2", reason="it was not seated")
    first, second = line.registry.calibrations.history("A2")
    assert "s1" in first.reason and second.reason == "it was not seated"


@pytest.mark.parametrize(
    ("kind", "serial", "code"),
    [("unit", "A0", "run.wrong_kind"), ("source", "A7", "run.wrong_kind"), ("unit", "a b", "")],
)
def test_an_order_that_makes_no_sense_moves_nothing(line, kind, serial, code):
    refused = line.order(kind, serial)
    assert (refused.state, refused.code) == (RunState.ERROR, "E-ORDER")
    assert not code or refused.message[0].code == code
    answered_at = datetime.now(UTC)
    assert line.wait_for(lambda beat: beat.at > answered_at).state is StationState.READY


def test_a_fault_in_mid_run_stops_the_station_and_an_acknowledgement_brings_it_back(line):
    assert line.order("fault", reason="load cell unplugged while pressing").state is RunState.DONE
    broken = line.order("unit", "A3")
    assert (broken.state, broken.code, broken.verdict) == (RunState.ERROR, "E-SILENT", "")
    heartbeat = line.wait_for(lambda heartbeat: heartbeat.state is StationState.STOPPED)
    assert "load cell" in broken.text and "load cell" in str(heartbeat.reasons[0])
    assert line.order("unit", "A3").code == "E-GATE"
    line.order("acknowledge")
    assert line.order("unit", "A3").state is RunState.DONE


@pytest.mark.long
def test_a_golden_unit_is_decided_and_one_out_of_control_quarantines_what_was_pressed(line):
    line.order("unit", "G1")
    assert line.order("golden", "G1").verdict == "pass"
    line.order("unit", "A5")
    line.registry.lots.set_limit("L1", 1e-6, reason="nothing is good enough")
    failed = line.order("golden", "G1")
    assert failed.verdict == "fail"
    assert failed.message[-1] == reason("golden.held", serials="L1/A5")
    assert [run.passed for run in line.registry.stations.golden_runs("s1")] == [True, False]
    assert [row.action for row in line.registry.trail.rows()].count("quarantine") == 1


def test_an_unknown_fault_names_the_known_ones(line):
    refused = line.order("fault", reason="earthquake")
    assert (refused.state, refused.message[0].code) == (RunState.ERROR, "fault.unknown")
    assert "homing switch missing" in refused.text


def test_a_stop_before_the_run_began_means_that_run_too(line):
    # Both orders are there before the service looks: the stop must not leave the run behind it standing.
    with line.registry.transaction():
        run, stop = line.place_order("unit", "A4"), line.place_order("stop")
    line.ended(stop)
    assert line.queue.progress(run).state is RunState.CANCELLED
    assert line.queue.progress(run).phase == ""


def test_the_gate_tells_every_condition_and_an_override_opens_it(tmp_path):
    with served(tmp_path, rules=GateRules()) as line:
        heartbeat = line.wait_for(lambda heartbeat: heartbeat.state is StationState.CLOSED)
        assert {str(c.name): c.is_good for c in heartbeat.gate} == {
            "certificate": False,
            "warm-up": False,
            "zero return": True,
            "homing": True,
            "golden unit": False,
        }
        refused = line.order("source", "A0")
        assert refused.code == "E-GATE"
        assert len(refused.message) >= 3  # All reasons at once.
        assert line.order("override").state is RunState.ERROR
        line.registry.stations.add_certificate(
            CellCertificate("SIM-CELL", "17", "Lab", date(2020, 1, 1), date(2090, 1, 1), 20.0, 0.02)
        )
        assert line.order("override", reason="first set-up").state is RunState.DONE
        heartbeat = line.wait_for(lambda heartbeat: heartbeat.is_overridden)
        assert heartbeat.state is StationState.READY
        assert line.order("check").state is RunState.DONE


def test_a_terminated_service_stops_its_run_and_says_that_it_is_off(tmp_path):
    with served(tmp_path, speed=5.0, unit_s=300.0) as line:
        line.queue.place(Order("long", "s1", OrderKind.SOURCE, "A0", "L1"))
        wait_until(lambda: line.queue.progress("long").phase == "homing")
        line.end()
        assert line.queue.progress("long").state is RunState.CANCELLED
        assert line.queue.heartbeat("s1").state is StationState.OFF


def test_a_service_that_was_silent_too_long_gives_way_to_the_new_owner(tmp_path):
    with served(tmp_path) as line:
        with line.registry.database.writing(in_turn=False) as connection:
            connection.execute(update(heartbeats).values(process="other:1"))
        line.thread.join(30)
        assert not line.thread.is_alive()
        assert "other:1" in str(line.error)
        assert line.queue.heartbeat("s1").process == "other:1"
