"""What a scan does to the rows of the registry; the station is played by its rows alone."""

import os
import socket
import subprocess
import threading
import time
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from softcal.app.bootstrap import is_alive
from softcal.app.line import line as line_module
from softcal.app.line.line import order_stop, take_scan
from softcal.app.line.status import Screen, read_line
from softcal.core.errors import InputError
from softcal.core.lot import Lot
from softcal.core.messages.reason import plain
from softcal.core.orders import Heartbeat, Order, OrderKind, Progress, RunState, StationState
from softcal.core.quality.line_rules import LineRules
from softcal.db.connection import open_registry
from softcal.db.entries import GoldenRun

HERE = Screen(tab="here")
OTHER_TAB = Screen(tab="other")


class Line:
    """A registry with one lot and one station that says it is there."""

    def __init__(self, registry):
        self.registry, self.queue = registry, registry.order_queue
        registry.lots.add(Lot("L1", "A0", 50.0))
        self.write_heartbeat()

    def write_heartbeat(self, state=StationState.READY, age_s=-25.0, reasons=(), process="host:1"):
        # As far ahead as clocks may be: a slow machine must not let it grow silent.
        at = datetime.now(UTC) - timedelta(seconds=age_s)
        self.queue.write_heartbeat(Heartbeat("line-1", state, at, reasons, process))

    def scan(self, text, screen=HERE):
        """Scan, and return the key of what is said then."""
        note = take_scan(self.registry, screen, text, "kim").note
        return note.key if note else None

    def start(self, serial):
        """Scan a unit and the start; return the key of what is said then."""
        self.scan(serial)
        return self.scan("CMD:START")

    def orders(self):
        return [(order.kind, order.serial, order.reason) for order, _ in self.queue.runs("line-1")]

    def end(self, state=RunState.DONE, **fields):
        """The station takes the order in progress and ends it."""
        order = self.queue.take("line-1")
        if fields.get("verdict") in ("fail", "retest"):
            self.registry.calibrations.refuse("L1", order.serial, fields["verdict"], (plain(f"{datetime.now(UTC)}"),))
        self.queue.report(Progress(order.order_id, state, **fields))
        return order

    @property
    def status(self):
        return read_line(self.registry, HERE)


def test_nobody_presses_without_a_badge_where_the_lot_wants_one(line) -> None:
    line.registry.lots.set_line_rules("L1", LineRules(is_badge_needed=True), reason="customer")
    register(line.registry, "L1", "A1")
    for text in ("A1", "CMD:START"):
        note = take_scan(line.registry, HERE, text).note
    assert note is not None and (note.key, note.is_refusal) == ("badge_first", True) and line.orders() == []
    for text in ("BADGE:kim", "CMD:START"):
        take_scan(line.registry, HERE, text)
    assert [serial for _, serial, _ in line.orders()] == ["A1"]


def register(registry, lot_id: str, serial: str) -> None:
    """Put a unit into a lot by its name alone."""
    with registry.database.writing():
        registry.lots._add_unit(lot_id, serial, "target", None)


@pytest.fixture
def line(tmp_path):
    with open_registry(f"sqlite:///{tmp_path / 'r.db'}") as registry:
        yield Line(registry)


def test_a_scan_moves_nothing_until_somebody_starts(line):
    assert line.scan("a1") is None
    assert line.status.serial == "A1" and line.orders() == []
    line.scan("CMD:START")
    assert line.orders() == [(OrderKind.UNIT, "A1", "")]
    order = line.queue.runs("line-1")[0][0]
    assert (order.lot_id, order.actor) == ("L1", "kim")


def test_a_unit_waits_at_every_screen_and_an_ordered_one_at_none(line):
    line.scan("A1")
    assert read_line(line.registry, OTHER_TAB).serial == "A1"
    line.scan("CMD:START")
    line.end(verdict="pass")
    assert read_line(line.registry, OTHER_TAB).serial == ""


@pytest.mark.parametrize(
    ("scanned", "refusal"),
    [
        ("A0", "is_source"),
        ("LOT:nowhere", "unknown_lot"),
        ("not a serial!", "bad_serial"),
        ("http://x.y", "unreadable"),
        ("CMD:START", "scan_first"),
        ("CMD:REPEAT", "nothing_to_confirm"),
        ("CMD:STOP", "nothing_runs"),
        ("CMD:OK", "nothing_to_confirm"),
        ("(21)A1(10)L9", "other_lot"),
    ],
)
def test_what_cannot_be_done_is_reported_and_orders_nothing(line, scanned, refusal):
    assert line.scan(scanned) == refusal
    assert line.orders() == []


def test_a_unit_of_another_lot_is_refused_by_its_row_and_by_its_pattern(line):
    line.registry.lots.add(Lot("L2", "B0", 50.0))
    register(line.registry, "L2", "X7")
    line.registry.lots.set_line_rules("L1", LineRules(r"A\d+", "upper"), reason="drawing")
    line.registry.lots.set_line_rules("L2", LineRules(r"B\d+", "upper"), reason="drawing")
    line.scan("LOT:l1")
    assert [line.scan(code) for code in ("X7", "b3", "C1", "a1")] == ["other_lot", "other_lot", "bad_serial", None]
    assert line.status.serial == "A1"


def test_two_lots_ask_for_the_lot_first_and_remember_the_one_pressed_last(line):
    line.registry.lots.add(Lot("L2", "B0", 50.0))
    assert line.scan("B1") == "no_lot"
    assert line.scan("LOT:L2") == "lot"
    line.start("B1")
    line.end(verdict="fail", code="")
    assert line.status.lot.id == "L2"


def test_scans_during_a_run_are_refused_at_every_screen(line):
    line.start("A1")
    for screen in (HERE, OTHER_TAB):
        answers = [line.scan(code, screen) for code in ("A2", "CMD:START", "CMD:OK")]
        assert answers == ["busy", "busy_key", "busy_key"]
    assert len(line.orders()) == 1


def test_what_was_refused_in_a_run_is_reported_after_it_and_a_useless_key_is_not(line):
    line.start("A1")
    line.scan("A2")
    line.end(verdict="pass")
    note = line.status.note
    assert (note.key, note.values["scanned"], note.values["serial"]) == ("meanwhile", "A2", "A1")
    line.start("A3")
    line.scan("CMD:START")
    line.end(verdict="pass")
    assert line.status.note is None


def test_a_stop_is_ordered_in_mid_run(line):
    line.start("A1")
    line.queue.take("line-1")
    assert line.scan("CMD:STOP") == "stopping"
    assert line.queue.take("line-1").kind is OrderKind.STOP


def test_a_stop_that_comes_by_two_ways_is_one_order_and_names_the_badge(line):
    line.scan("BADGE:Mia")
    line.scan("A1")
    assert not order_stop(line.registry, "")  # Nothing runs: there is nothing to stop.
    line.scan("CMD:START")
    assert order_stop(line.registry, "") and order_stop(line.registry, "line-1")
    assert line.scan("CMD:STOP") == "stopping"
    stops = [order for order, _ in line.queue.runs("line-1") if order.kind is OrderKind.STOP]
    assert [order.actor for order in stops] == ["Mia (badge)"]


def test_after_a_stop_nothing_goes_on_until_it_was_read_and_then_the_unit_is_scanned_again(line):
    line.start("A1")
    line.end(RunState.ERROR, code="E-SILENT", message="gone")
    line.write_heartbeat(StationState.STOPPED, reasons=("gone",))
    assert line.scan("A2") == "acknowledge_first"
    assert line.scan("CMD:OK") == "acknowledged"
    assert line.end().kind is OrderKind.ACKNOWLEDGE
    line.write_heartbeat()
    assert line.status.serial == "" and line.status.is_unit_uncertain
    assert line.scan("CMD:START") == "scan_first"
    line.start("A1")
    assert line.queue.active("line-1")[0].serial == "A1"


@pytest.mark.parametrize("refused", ["A0", "X7", "not a serial!", "http://x.y", "LOT:nowhere"])
def test_a_refused_scan_takes_the_unit_before_it_off_the_screen(line, refused):
    line.registry.lots.add(Lot("L2", "B0", 50.0))
    register(line.registry, "L2", "X7")
    line.scan("LOT:L1")
    line.scan("A1")
    assert line.status.serial == "A1" and line.scan(refused) is not None
    assert line.status.serial == "" and line.scan("CMD:START") == "scan_first"
    assert line.orders() == []


@pytest.mark.parametrize("key", ["CMD:OK", "CMD:REPEAT", "CMD:CANCEL", "CMD:STOP"])
def test_no_key_but_the_one_that_starts_ever_presses(line, key):
    line.scan("A1")
    for _ in range(3):
        line.scan(key)
    assert [order for order in line.orders() if order[0].is_run] == []


def test_a_unit_is_scanned_again_after_the_station_s_service_was_started_again(line):
    line.scan("A1")
    line.write_heartbeat(age_s=-120.0, process="host:1")
    assert line.status.serial == "A1"
    line.write_heartbeat(StationState.OFF, age_s=-180.0)
    line.write_heartbeat(age_s=-240.0, process="host:2")
    assert line.status.serial == "" and line.scan("CMD:START") == "scan_first"


def test_a_key_at_a_screen_that_showed_something_else_presses_nothing(line):
    stale_view = replace(OTHER_TAB, version=line.status.session.version)
    line.scan("A2")
    assert line.scan("CMD:START", stale_view) == "look_again"
    assert line.orders() == []
    assert line.scan("CMD:START", replace(OTHER_TAB, version=line.status.session.version)) is None
    assert line.orders() == [(OrderKind.UNIT, "A2", "")]


def test_a_unit_with_a_result_is_only_pressed_once_that_was_read_and_as_often_as_the_rules_allow(line):
    line.registry.lots.set_line_rules("L1", LineRules(retests={"fail": 1}), reason="customer")
    line.start("A1")
    line.end(verdict="fail")
    assert line.scan("CMD:OK") == "nothing_to_confirm"
    line.scan("A1")
    assert line.status.remaining_retests == 1
    assert line.scan("CMD:START") == "ask_first"
    assert line.scan("CMD:OK") is None and line.scan("CMD:OK") == "nothing_to_confirm"
    assert line.scan("CMD:START") is None
    line.end(verdict="fail")
    line.scan("A1")
    assert [line.scan("CMD:OK"), line.scan("CMD:START")] == ["used_up_first"] * 2
    assert line.orders() == [(OrderKind.UNIT, "A1", "re-test after fail"), (OrderKind.UNIT, "A1", "")]


def test_a_recording_that_cannot_be_used_is_repeated_after_a_scan_without_a_question(line):
    line.start("A1")
    line.end(verdict="retest")
    assert line.scan("CMD:START") == "scan_first"
    assert line.start("A1") is None
    assert line.queue.active("line-1")[0].reason == "re-test after retest"


def test_a_run_that_broke_is_no_test(line):
    line.registry.lots.set_line_rules("L1", LineRules(retests={}), reason="strict")
    for _ in range(3):
        assert line.start("A1") is None
        line.end(RunState.ERROR, code="E-INTERRUPTED")


def scan_and_read_question(line, serial):
    line.scan(serial)
    return line.status.open_question


def test_a_serial_unlike_any_of_the_lot_becomes_a_unit_only_once_that_was_read(line):
    assert scan_and_read_question(line, "A12") == "ask_new" and line.scan("CMD:START") == "ask_new_first"
    line.scan("CMD:OK")
    assert line.scan("CMD:START") is None
    line.end(verdict="pass")
    assert scan_and_read_question(line, "A13") == ""


def test_where_units_were_registered_by_name_every_other_one_is_asked_for(line):
    register(line.registry, "L1", "A1")
    assert (scan_and_read_question(line, "A2"), scan_and_read_question(line, "A1")) == ("ask_new", "")


def test_a_rule_of_the_lot_says_which_serials_are_its_own(line):
    line.registry.lots.set_line_rules("L1", LineRules(r"A\d+", "upper"), reason="drawing")
    assert scan_and_read_question(line, "A12") == ""


def test_nothing_is_ordered_from_a_station_that_is_not_there_or_may_not_run(line):
    line.scan("A1")
    line.write_heartbeat(age_s=4)
    assert line.scan("CMD:START") == "silent"
    line.write_heartbeat(StationState.CLOSED)
    assert line.scan("CMD:START") == "closed"
    assert line.orders() == []


def test_a_golden_unit_is_known_by_its_label_and_later_by_its_serial(line):
    line.write_heartbeat(StationState.CLOSED)
    line.scan("GOLDEN:G1")
    line.scan("CMD:START")
    assert line.orders()[0][:2] == (OrderKind.GOLDEN, "G1")
    line.end(verdict="pass")
    line.registry.stations.add_golden_run(
        GoldenRun("line-1", "small", "G1", datetime.now(UTC), 0.1, "N", True, (), "kim")
    )
    line.scan("G1")
    assert line.status.is_golden


def test_a_badge_names_the_operator_at_every_screen_and_orders_say_that_it_was_a_badge(line):
    assert line.scan("BADGE:Kim") == "badge"
    assert read_line(line.registry, OTHER_TAB).operator == "Kim"
    take_scan(line.registry, HERE, "A1")
    take_scan(line.registry, HERE, "CMD:START")
    assert line.queue.active("line-1")[0].actor == "Kim (badge)"
    assert take_scan(line.registry, HERE, "BADGE:").operator == ""


def test_a_badge_ends_with_the_shift_and_that_is_seen(line):
    context = take_scan(line.registry, HERE, "BADGE:Kim")
    later = replace(context, now=context.now + timedelta(hours=11))
    assert later.operator == "" and later.session.operator == "Kim"


def test_a_name_that_opens_more_than_the_line_is_not_taken_from_a_badge(line):
    line.registry.people.set("Quinn", "quality", "7391", actor="test")
    assert line.scan("BADGE:quinn") == "badge_needs_pin"
    assert line.status.operator == ""


def test_a_chosen_station_is_one_of_several(line):
    line.queue.write_heartbeat(Heartbeat("line-2", StationState.READY, datetime.now(UTC)))
    assert line.status.station == ""
    assert read_line(line.registry, replace(HERE, station="line-2")).station == "line-2"
    with pytest.raises(InputError):
        line.scan("A1")


def test_an_order_of_somebody_else_in_the_same_moment_leaves_the_unit_to_be_scanned_again(line, monkeypatch):
    line.scan("A1")
    place_order = type(line.queue).place

    def late(queue, order, **how):
        monkeypatch.undo()
        queue.place(Order("x", "line-1", OrderKind.CHECK))
        place_order(queue, order, **how)

    monkeypatch.setattr(type(line.queue), "place", late)
    assert line.scan("CMD:START") == "busy_key"
    assert line.status.serial == "" and line.orders() == [(OrderKind.CHECK, "", "")]


@pytest.mark.parametrize("waiting_call", ["the place", "the order"])
def test_a_start_that_waited_longer_than_the_screen_says_moves_nothing(line, monkeypatch, waiting_call):
    line.scan("A1")
    monkeypatch.setattr(line_module, "START_S", 0.3)
    queue, sessions = type(line.queue), type(line.registry.line_sessions)
    owner, name = (sessions, "write") if waiting_call == "the place" else (queue, "place")
    begin, is_waiting = getattr(owner, name), threading.Event()

    def hold():
        with open_registry(line.registry.database.engine.url.render_as_string()) as other:
            with other.database.writing():
                is_waiting.set()
                time.sleep(1.0)

    def call_while_waiting(*positional, **keywords):
        monkeypatch.setattr(owner, name, begin)
        holder = threading.Thread(target=hold)
        holder.start()
        is_waiting.wait()
        return begin(*positional, **keywords)

    monkeypatch.setattr(owner, name, call_while_waiting)
    assert line.scan("CMD:START") == "late_start"
    assert line.status.serial == "" and line.orders() == []


@pytest.mark.parametrize(("ahead_s", "start_s"), [(-0.1, 120.0), (1e6, -0.1)], ids=["on its way", "another clock"])
def test_a_start_that_is_late_moves_nothing_whatever_clock_set_its_deadline(line, monkeypatch, ahead_s, start_s):
    line.scan("A1")
    monkeypatch.setattr(line_module, "START_S", start_s)
    assert line.scan("CMD:START", replace(HERE, until_s=time.monotonic() + ahead_s)) == "late_start"
    assert line.status.serial == "" and line.orders() == []


def test_a_service_whose_process_is_gone_is_gone_at_once_and_one_that_lives_may_be_late(line):
    ended_process = subprocess.Popen(["true"])
    ended_process.wait()
    heartbeat, here = line.status.heartbeat, socket.gethostname()
    processes = f"{here}:{ended_process.pid}", f"{here}:{os.getpid()}", "host:1"
    assert [*map(is_alive, processes)] == [False, True, None]
    cases = ((False, 0, False), (True, 8, True), (True, 20, False), (None, 2, True), (None, 4, False))
    for lives, age_s, is_there in cases:
        context = replace(line.status, is_alive=lives, heartbeat=heartbeat, now=heartbeat.at + timedelta(seconds=age_s))
        assert context.is_answering is is_there, (lives, age_s)
