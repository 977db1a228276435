"""The resident service: one order at a time, a stop needs an acknowledgement, ports are opened again after a fault."""

from contextlib import contextmanager, nullcontext

import pytest
from common.rig_trial import RigCase, open_rig

from softcal.core.errors import NoReply, RegistryError
from softcal.core.messages.reason import root_of
from softcal.core.orders import Condition, Order, OrderKind, RunState, StationState
from softcal.core.profiles import ramps
from softcal.core.quality.gate import Gate
from softcal.station.bench.bench import open_simulated_bench
from softcal.station.devices.config import UNKNOWN_S
from softcal.station.tasks.service import Hooks, StationService

QUICK = ramps([2.0], 4.0, rest_s=0.3, name="quick")
PROFILES = {OrderKind.SOURCE: QUICK, OrderKind.UNIT: QUICK, OrderKind.GOLDEN: QUICK}


class Host:
    """Everything a host gives, in memory."""

    def __init__(self) -> None:
        self.reports, self.stations, self.reasons = [], [], ()
        self.stop_at_phase = ""
        self.stage_kind = "grbl"
        self.on_report = lambda progress: None

    def report(self, progress):
        self.reports.append(progress)
        self.on_report(progress)

    def is_stop_requested(self):
        return bool(self.stop_at_phase) and bool(self.reports) and self.reports[-1].phase == self.stop_at_phase

    def gate(self, kind, rig):
        self.rig = rig
        reasons = () if kind in (OrderKind.GOLDEN, OrderKind.CHECK) else self.reasons
        return Gate(tuple(Condition("golden unit", False, reason) for reason in reasons))

    @contextmanager
    def open_bench(self):
        with open_simulated_bench(seed=len(self.stations), stage_kind=self.stage_kind) as (bench, station):
            self.stations.append(station)
            yield bench

    def service(self, folder):
        # Looked up at each call: a test may put others in their place.
        hooks = Hooks(self.report, lambda: self.is_stop_requested(), lambda kind, rig: self.gate(kind, rig))
        service = StationService(self.open_bench, PROFILES, folder, hooks)
        service.start()
        return service


@pytest.fixture
def host():
    return Host()


@pytest.fixture
def service(host, tmp_path):
    service = host.service(tmp_path)
    yield service
    service.close()


def order(kind=OrderKind.UNIT, serial="A1", order_id="1"):
    return Order(order_id, "s1", kind, serial)


def test_a_unit_is_pressed_and_its_progress_reported(host, service):
    recording = service.perform(order())
    assert recording is not None and recording.force_N is None
    assert service.state is StationState.READY
    assert {"searching for contact", "pressing"} <= {report.phase for report in host.reports}
    assert host.reports[-1].signal.output_unit == "V"


def test_how_late_the_cell_is_is_learnt_from_the_first_unit(tmp_path):
    unknown = RigCase(cell_late_s=0.1, latency_s=UNKNOWN_S, stiffest_N_mm=60.0, limit_N=12.0)
    host, took_s = Host(), []
    with open_rig(unknown) as (bench, station):
        host.open_bench = lambda: nullcontext(bench)
        service = host.service(tmp_path)
        for serial in ("A1", "A2", "A3"):
            began_s = station.world.now_s()
            recording = service.perform(order(OrderKind.UNIT, serial))
            took_s.append(station.world.now_s() - began_s)
            assert recording.alignment.force_behind_s == pytest.approx(0.1, abs=0.015)
        assert max(took_s[1:]) < 0.7 * took_s[0]
        station.force_wire.delay_s += 0.1
        assert service.perform(order(OrderKind.UNIT, "A4")) is None
        assert [root_of(why).code for why in host.reports[-1].message] == ["rig.behind"]
        service.start()  # What was learnt is gone with it: the next unit is felt slowly again.
        began_s = station.world.now_s()
        assert service.perform(order(OrderKind.UNIT, "A4")).alignment.force_behind_s == pytest.approx(0.2, abs=0.015)
        assert station.world.now_s() - began_s > 0.9 * took_s[0]


def test_a_closed_gate_refuses_with_its_reasons_but_lets_the_golden_unit_in(host, service):
    host.reasons = ("no golden unit was pressed in this shift; press one",)
    service.settle()
    assert service.state is StationState.CLOSED
    assert service.perform(order()) is None
    assert (host.reports[-1].code, host.reports[-1].state) == ("E-GATE", RunState.ERROR)
    golden = service.perform(order(OrderKind.GOLDEN, "G1", "2"))
    assert golden is not None and golden.force_N is not None


def test_a_fault_stops_the_station_until_somebody_acknowledges(host, service):
    host.on_report = lambda progress: progress.phase == "pressing" and host.stations[-1].force_wire.unplug()
    assert service.perform(order()) is None
    assert service.state is StationState.STOPPED
    assert host.reports[-1].code == "E-SILENT"
    host.on_report = lambda progress: None
    assert service.perform(order(order_id="2")) is None
    assert host.reports[-1].state is RunState.ERROR
    service.perform(order(OrderKind.ACKNOWLEDGE, order_id="3"))
    assert service.state is StationState.READY
    assert service.perform(order(order_id="4")) is not None


def test_a_stop_of_a_person_cancels_the_run_and_lifts_the_stage(host, service):
    host.stop_at_phase = "pressing"
    assert service.perform(order()) is None
    assert host.reports[-1].state is RunState.CANCELLED
    assert not host.stations[-1].axis.is_moving


@pytest.mark.parametrize("kind", ["grbl", "zaber", "esm"])
def test_a_stop_of_a_person_ends_homing_too(host, tmp_path, kind):
    host.stage_kind = kind
    service = host.service(tmp_path)
    host.stations[-1].axis.position_mm = 30.0
    host.stop_at_phase = "homing"
    assert service.perform(order()) is None
    assert host.reports[-1].state is RunState.CANCELLED
    assert host.stations[-1].axis.position_mm > 5.0  # on its way, not at its switch
    assert not host.stations[-1].axis.is_moving
    assert not service.rig.is_homed
    service.close()


def test_missing_devices_leave_the_station_stopped_with_all_of_them_named(host, tmp_path):
    @contextmanager
    def nothing():
        raise NoReply("stage (/dev/a): no such port; load cell (/dev/b): no such port")
        yield

    service = StationService(nothing, PROFILES, tmp_path, Hooks(host.report, host.is_stop_requested, host.gate))
    service.start()
    assert service.state is StationState.STOPPED
    assert "/dev/a" in str(service.reasons[0]) and "/dev/b" in str(service.reasons[0])


def test_a_device_that_goes_between_two_runs_is_seen_at_once(host, service):
    service.poll_idle(0.01)
    assert service.state is StationState.READY
    host.stations[-1].readout_wire.unplug()
    service.poll_idle(0.01)
    assert service.state is StationState.STOPPED
    assert service.reasons[0].code == "rig.gone"


def test_a_stream_that_falls_silent_between_two_runs_is_seen(host, service):
    host.stations[-1].force_wire.is_silent = True
    for _ in range(30):
        service.poll_idle(0.1)
    assert service.state is StationState.STOPPED
    assert (service.reasons[0].code, service.reasons[0].values["device"].code) == ("rig.silent.between", "device.cell")
    assert service.reasons[0].values["seconds"] == pytest.approx(2.0, abs=0.2)


def test_a_hand_at_the_fixture_between_two_runs_stops_nothing(host, service):
    host.stations[-1].rig.force_fault = lambda now_s, force_N: 1e6
    for _ in range(30):
        service.poll_idle(0.1)
    assert service.state is StationState.READY


@pytest.mark.parametrize(
    ("break_it", "fault"),
    [
        (lambda station: setattr(station.stage, "switch", "missing"), "homing_fault"),
        (lambda station: setattr(station.rig, "force_fault", lambda now_s, force_N: force_N + 3.0), "zero_fault"),
    ],
)
def test_a_fault_of_homing_or_zero_is_reported_to_the_gate_until_a_self_test_is_good(host, service, break_it, fault):
    break_it(host.stations[-1])
    service.perform(order())
    assert host.reports[-1].state is RunState.ERROR
    service.perform(order(OrderKind.ACKNOWLEDGE, order_id="2"))
    assert getattr(host.rig, fault)
    assert service.perform(Order("3", "s1", OrderKind.CHECK)) is None
    assert host.reports[-1].state is RunState.DONE and service.findings
    service.settle()
    assert not getattr(host.rig, fault)
    assert host.rig.is_homed


def test_no_number_of_the_live_signal_is_missing(host, service):
    service.perform(order())
    for report in host.reports:
        for name in ("t_s", "output", "stage_mm", "force_N"):
            assert all(value == value and value is not None for value in getattr(report.signal, name))


def test_a_registry_that_goes_away_at_the_end_of_a_run_costs_no_recording(host, service):
    def away(kind, rig):
        raise RegistryError("the registry is away")

    host.on_report = lambda progress: setattr(host, "gate", away) if progress.phase == "pressing" else None
    assert service.perform(order()) is not None


def test_a_defect_in_a_run_stops_the_station_and_the_stage(host, service):
    host.on_report = lambda progress: 1 / 0 if progress.phase == "pressing" else None
    with pytest.raises(ZeroDivisionError):
        service.perform(order())
    assert service.state is StationState.STOPPED
    assert not host.stations[-1].axis.is_moving


@pytest.mark.parametrize("after_s", [0.0, 0.03, 0.06, 0.09])
def test_a_stop_reaches_the_stage_at_the_next_look_at_the_devices(host, service, after_s):
    asked_s = []

    def is_stop_requested():
        now_s, pressing = host.stations[-1].world.now_s(), [r for r in host.reports if r.phase == "pressing"]
        if pressing and not asked_s:
            asked_s.append(now_s + after_s)
            host.stations[-1].stage.stop_received_s = None  # The search for contact ended in a stop, too.
        return bool(asked_s) and now_s >= asked_s[0]

    host.is_stop_requested = is_stop_requested
    service.perform(order())
    # Looks are 5 ms apart; a stop that waits for the next report on the screen would take up to 100 ms.
    assert host.stations[-1].stage.stop_received_s - asked_s[0] < 0.02
