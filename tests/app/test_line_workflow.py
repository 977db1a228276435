"""What a scan does to the rows of the registry; the station is played by its rows alone."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from softcal.app.line.line import Choice, read_line, take_scan
from softcal.core.lot import Lot
from softcal.core.orders import Heartbeat, Order, OrderKind, Progress, RunState, StationState
from softcal.core.quality.line_rules import LineRules
from softcal.core.reason import plain
from softcal.db.connection import open_registry
from softcal.db.entries import GoldenRun

NOBODY = Choice()


class Line:
    """A registry with one lot and one station that says it is there."""

    def __init__(self, registry):
        self.registry, self.queue, self.choice = registry, registry.order_queue, NOBODY
        registry.add_lot(Lot("L1", "A0", 50.0))
        self.beat()

    def beat(self, state=StationState.READY, age_s=-60.0, reasons=()):
        # A minute ahead unless told otherwise: a slow machine must not let it grow silent meanwhile.
        at = datetime.now(UTC) - timedelta(seconds=age_s)
        self.queue.beat(Heartbeat("line-1", state, at, reasons, "host:1"))

    def scan(self, text):
        answer = take_scan(self.registry, self.choice, text, "kim")
        self.choice = answer.choice
        return answer.note.key if answer.note else None

    def orders(self):
        return [(order.kind, order.serial, order.reason) for order, _ in self.queue.runs("line-1")]

    def end(self, state=RunState.DONE, **facts):
        """The station takes the order in progress and ends it."""
        order = self.queue.take("line-1")
        if facts.get("verdict") in ("fail", "retest"):
            self.registry.add_refusal("L1", order.serial, facts["verdict"], (plain(f"{datetime.now(UTC)}"),))
        self.queue.report(Progress(order.order_id, state, **facts))
        return order

    @property
    def facts(self):
        return read_line(self.registry, self.choice)


@pytest.fixture
def line(tmp_path):
    with open_registry(f"sqlite:///{tmp_path / 'r.db'}") as registry:
        yield Line(registry)


def test_a_scan_moves_nothing_until_somebody_starts(line):
    assert line.scan("a1") is None
    assert line.facts.serial == "A1" and line.orders() == []
    line.scan("CMD:START")
    assert line.orders() == [(OrderKind.UNIT, "A1", "")]
    order = line.queue.runs("line-1")[0][0]
    assert (order.lot_id, order.actor) == ("L1", "kim")


def test_an_ordered_unit_is_no_longer_waited_for_in_another_tab_either(line):
    line.scan("A1")
    other_tab = line.choice
    line.scan("CMD:START")
    line.end(verdict="pass")
    assert read_line(line.registry, other_tab).serial == ""


@pytest.mark.parametrize(
    ("scanned", "refusal"),
    [
        ("A0", "is_source"),
        ("LOT:nowhere", "unknown_lot"),
        ("not a serial!", "bad_serial"),
        ("http://x.y", "unreadable"),
        ("CMD:START", "scan_first"),
        ("CMD:REPEAT", "scan_first"),
        ("CMD:STOP", "nothing_runs"),
        ("CMD:OK", "nothing_to_confirm"),
        ("(21)A1(10)L9", "other_lot"),
    ],
)
def test_what_cannot_be_done_is_said_and_orders_nothing(line, scanned, refusal):
    assert line.scan(scanned) == refusal
    assert line.orders() == []


def test_a_unit_of_another_lot_is_refused_by_its_row_and_by_its_pattern(line):
    line.registry.add_lot(Lot("L2", "B0", 50.0))
    line.registry.add_unit("L2", "X7")
    line.registry.set_line_rules("L1", LineRules(r"A\d+", "upper"), reason="drawing")
    line.registry.set_line_rules("L2", LineRules(r"B\d+", "upper"), reason="drawing")
    line.scan("LOT:l1")
    assert [line.scan(code) for code in ("X7", "b3", "C1", "a1")] == ["other_lot", "other_lot", "bad_serial", None]


def test_two_lots_ask_for_the_lot_first_and_remember_the_one_pressed_last(line):
    line.registry.add_lot(Lot("L2", "B0", 50.0))
    assert line.scan("B1") == "no_lot"
    assert line.scan("LOT:L2") == "lot"
    line.scan("B1")
    line.scan("CMD:START")
    line.end(verdict="fail", code="")
    assert read_line(line.registry, NOBODY).lot.id == "L2"


def test_scans_during_a_run_are_refused(line):
    line.scan("A1")
    line.scan("CMD:START")
    assert [line.scan(code) for code in ("A2", "CMD:START", "CMD:REPEAT")] == ["busy"] * 3
    assert len(line.orders()) == 1


def test_a_stop_is_ordered_in_mid_run(line):
    line.scan("A1")
    line.scan("CMD:START")
    line.queue.take("line-1")
    assert line.scan("CMD:STOP") == "stopping"
    assert line.queue.take("line-1").kind is OrderKind.STOP


def test_after_a_stop_nothing_goes_on_until_it_was_read_and_then_the_unit_is_asked_for_again(line):
    line.scan("A1")
    line.scan("CMD:START")
    line.end(RunState.ERROR, code="E-SILENT", message="gone")
    line.beat(StationState.STOPPED, reasons=("gone",))
    assert line.scan("A2") == "acknowledge_first"
    line.scan("CMD:OK")
    assert line.end().kind is OrderKind.ACKNOWLEDGE
    line.beat()
    assert line.facts.serial == "A1"
    line.scan("CMD:START")
    assert line.queue.active("line-1")[0].serial == "A1"


def test_a_unit_with_a_result_is_only_pressed_again_by_repeat_and_as_often_as_the_rules_allow(line):
    line.registry.set_line_rules("L1", LineRules(retests={"fail": 1}), reason="customer")
    line.scan("A1")
    line.scan("CMD:START")
    line.end(verdict="fail")
    assert line.scan("CMD:REPEAT") == "scan_first"
    line.scan("A1")
    assert line.facts.retests_left == 1
    assert line.scan("CMD:START") == "repeat_instead"
    assert line.scan("CMD:REPEAT") is None
    line.end(verdict="fail")
    line.scan("A1")
    assert line.scan("CMD:REPEAT") == "no_retest"
    assert line.orders() == [(OrderKind.UNIT, "A1", "re-test after fail"), (OrderKind.UNIT, "A1", "")]


def test_a_recording_that_cannot_be_used_is_repeated_without_a_scan(line):
    line.scan("A1")
    line.scan("CMD:START")
    line.end(verdict="retest")
    assert line.scan("CMD:REPEAT") is None
    assert line.queue.active("line-1")[0].reason == "re-test after retest"


def test_a_run_that_broke_is_no_test(line):
    line.registry.set_line_rules("L1", LineRules(retests={}), reason="strict")
    for _ in range(3):
        line.scan("A1")
        line.scan("CMD:START")
        line.end(RunState.ERROR, code="E-INTERRUPTED")
    assert line.scan("CMD:REPEAT") is None


def test_nothing_is_ordered_from_a_station_that_is_not_there_or_may_not_run(line):
    line.scan("A1")
    line.beat(age_s=4)
    assert line.scan("CMD:START") == "silent"
    line.beat(StationState.CLOSED)
    assert line.scan("CMD:START") == "closed"
    assert line.orders() == []


def test_a_golden_unit_is_known_by_its_label_and_later_by_its_serial(line):
    line.beat(StationState.CLOSED)
    line.scan("GOLDEN:G1")
    line.scan("CMD:START")
    assert line.orders()[0][:2] == (OrderKind.GOLDEN, "G1")
    line.end(verdict="pass")
    line.registry.add_golden_run(GoldenRun("line-1", "G1", datetime.now(UTC), 0.1, "N", True, (), "kim"))
    line.scan("G1")
    assert line.facts.is_golden


def test_a_badge_names_the_operator(line):
    answer = take_scan(line.registry, NOBODY, "BADGE:Kim", "")
    assert (answer.badge, answer.note.key) == ("Kim", "badge")
    assert take_scan(line.registry, NOBODY, "BADGE:", "").badge == ""


def test_a_chosen_station_is_one_of_several(line):
    line.queue.beat(Heartbeat("line-2", StationState.READY, datetime.now(UTC)))
    assert line.facts.station == ""
    line.choice = replace(NOBODY, station="line-2")
    assert line.facts.station == "line-2"


def test_a_start_from_two_tabs_is_one_run(line):
    line.scan("A1")
    both = line.choice
    first = take_scan(line.registry, both, "CMD:START", "kim")
    line.queue.place(Order("x", "line-2", OrderKind.UNIT, "A9", "L1"))
    second = take_scan(line.registry, both, "CMD:START", "lee")
    assert first.note is None and second.note.key == "busy"
    assert len(line.orders()) == 1
