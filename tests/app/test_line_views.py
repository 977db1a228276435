"""What the operator's screen shows in every situation, computed without a browser and without a station."""

import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path

import pytest

from softcal.app.charts import palette
from softcal.app.charts.live import live_signal
from softcal.app.line.status import LineSession, LineStatus, LotAtLine, Note
from softcal.app.texts import catalogue as texts
from softcal.app.texts.reasons import render_plain_reason, render_reason
from softcal.app.ui.components import line_card
from softcal.app.views import line as views_line
from softcal.app.views.line import KEYS, away_view, line_view
from softcal.app.views.line_states import STATES
from softcal.core.lot import Lot
from softcal.core.messages.reason import Reason, plain, reason
from softcal.core.orders import Condition, Heartbeat, Order, OrderKind, Progress, RunState, Signal, StationState
from softcal.core.quality.known_loads import KnownLoad, loads_text
from softcal.core.quality.line_rules import LineRules
from softcal.core.unit.verdict import Verdict
from softcal.db.entries import NetworkEntry, RunEntry, UnitResult
from softcal.db.repositories.networks import NetworkState
from softcal.station.tasks.service import CODES

NOW = datetime(2026, 5, 4, 8, 0, tzinfo=UTC)
NETWORK = NetworkState(NetworkEntry("c" * 64, "L1", "", {}, {}, NOW), "released", NOW)
LOT = LotAtLine(Lot("L1", "A0", 50.0, "eGaIn pad"), LineRules(), NETWORK, {"pass": 3, "fail": 1, "none": 2})
TRANSLATE = partial(texts.text, "en")
UNIT_DONE = Progress("o1", RunState.DONE, "done", 1.0, message="predicted RMSE 0.07 N; all is well", verdict="pass")


def heartbeat(state: StationState = StationState.READY, **fields) -> Heartbeat:
    return Heartbeat("line-1", state, NOW, **fields)


def run(progress: Progress = UNIT_DONE, kind: OrderKind = OrderKind.UNIT, serial: str = "A1"):
    return Order("o1", "line-1", kind, serial, "L1", "kim", created=NOW - timedelta(minutes=1)), progress


def line_status(**changes) -> LineStatus:
    return replace(LineStatus(NOW, ("line-1",), heartbeat(), lots=("L1",), lot=LOT), **changes)


def test_the_figure_of_a_run_has_units_on_its_axes() -> None:
    option = live_signal(Signal((0.0, 1.0), (2.0, 3.0), (0.0, 0.1), (), "V"), palette.LIGHT, TRANSLATE)
    axis_names = [axis["name"] for axis in (option["xAxis"], *option["yAxis"])]
    assert [name[name.index("[") :] for name in axis_names] == ["[s]", "[V]", "[mm]"]


def waits(serial: str = "A1", run: str = "", **more) -> LineSession:
    """A unit that was scanned after a run and waits."""
    return LineSession(3, run, serial, **more)


def result(verdict: str, times: int = 1) -> tuple[RunEntry, ...]:
    return tuple(RunEntry("A1", NOW - timedelta(hours=1), verdict, (plain("because"),)) for _ in range(times))


def card_of(**changes):
    return line_view(line_status(**changes), "Kim", TRANSLATE)


ERROR = Progress("o1", RunState.ERROR, code="E-SILENT", message="the load cell does not answer; the stage stands")
LOAD_VALUES = {"loads": loads_text((KnownLoad(0.0), KnownLoad(2.0, 0.002))), "of": 2, "unit": "N"}
LOAD_REQUESTED = replace(UNIT_DONE, verdict="", message=(reason("load.wanted", step=0, **LOAD_VALUES),))
SCANNED = LineSession(3, "an older run", process="")
SITUATIONS = {
    "no_station": {"heartbeat": None},
    "silent": {"heartbeat": replace(heartbeat(), at=NOW - timedelta(seconds=4))},
    "silent, ended in good order": {"heartbeat": heartbeat(StationState.OFF)},
    "no_lot": {"lot": None},
    "ready": {},
    "hand": {"session": LineSession(3, "o1"), "runs": (run(),)},
    "armed": {"session": waits()},
    "armed_golden": {"session": waits("G1", is_golden=True)},
    "ask": {"session": waits(), "results": result("pass")},
    "ask_new": {"session": waits("A123", is_new=True)},
    "used_up": {"session": waits(), "results": result("fail", 2)},
    "closed": {"heartbeat": heartbeat(StationState.CLOSED, reasons=("no golden unit",))},
    "running": {"active": run(Progress("o1", RunState.RUNNING, "pressing", 0.4, 12.0))},
    "stopped": {"heartbeat": heartbeat(StationState.STOPPED, reasons=(ERROR.text,)), "runs": (run(ERROR),)},
    "broken": {"runs": (run(replace(ERROR, code="E-INTERRUPTED")),)},
    "pass": {"runs": (run(),)},
    "conditional": {"runs": (run(replace(UNIT_DONE, verdict="conditional")),)},
    "fail": {"runs": (run(replace(UNIT_DONE, verdict="fail")),)},
    "retest": {"runs": (run(replace(UNIT_DONE, verdict="retest")),), "results": result("retest")},
    "retest_used_up": {"runs": (run(replace(UNIT_DONE, verdict="retest")),), "results": result("retest", 4)},
    "load": {"runs": (run(LOAD_REQUESTED),), "session": SCANNED},
    "reading": {"active": run(Progress("o1", RunState.RUNNING, "reading at rest", 0.4, 3.0), OrderKind.LOAD)},
    "recorded": {"runs": (run(replace(UNIT_DONE, verdict="")),)},
    "golden_pass": {"runs": (run(kind=OrderKind.GOLDEN),)},
    "golden_fail": {"runs": (run(replace(UNIT_DONE, verdict="fail"), OrderKind.GOLDEN),)},
}


def test_every_situation_has_its_state_with_a_word_and_an_instruction():
    for situation, changes in SITUATIONS.items():
        view = card_of(**changes)
        assert view.state == situation.split(",")[0] and view.word and view.instruction
        assert view.tone in line_card.MARKS
    assert {situation.split(",")[0] for situation in SITUATIONS} | {"away"} == set(STATES)


@pytest.mark.parametrize("language", texts.LANGUAGES)
def test_ready_says_that_a_unit_can_be_pressed_and_nothing_else(language):
    translate = partial(texts.text, language)
    texts_by_situation = {
        situation: line_view(line_status(**changes), "Kim", translate) for situation, changes in SITUATIONS.items()
    }
    ready = {
        situation for situation, view in texts_by_situation.items() if view.word == texts_by_situation["armed"].word
    }
    assert ready == {"ready", "armed"}
    for situation in ready:
        context = line_status(**SITUATIONS[situation])
        assert context.may_press and context.lot and context.station_state == "ready"


@pytest.mark.parametrize(
    ("code", "reason_values", "step"),
    [
        ("load.wanted", {"step": 0}, 1),
        ("load.read", {"step": 1, "level": 0.1}, 2),
        ("load.unsteady", {"step": 2, "drift": 0.1, "spread": 0.1}, 2),
        ("load.unloaded", {"step": 2, "level": 0.1}, 2),
        ("load.same", {"step": 2, "level": 0.1}, 2),
        ("load.contradict", {"step": 2, "why": "they fall"}, 1),
    ],
)
@pytest.mark.parametrize("language", texts.LANGUAGES)
def test_the_card_names_the_load_to_put_on_and_what_was_wrong_with_the_last(code, reason_values, step, language):
    translate, why = partial(texts.text, language), reason(code, **reason_values, **LOAD_VALUES)
    kind = OrderKind.UNIT if code == "load.wanted" else OrderKind.LOAD
    unit_done = replace(UNIT_DONE, verdict="", message=(why,))
    view = line_view(line_status(runs=(run(unit_done, kind),), session=SCANNED), "Kim", translate)
    assert (view.state, view.serial, view.actions) == ("load", "A1", ("START", "CANCEL"))
    request_values = {"step": step, "of": 2, "load": "2 ± 0.002 N"}
    assert view.instruction == translate("line.load.do.nothing" if step == 1 else "line.load.do", **request_values)
    assert view.details == (() if code == "load.wanted" else (render_plain_reason(why, translate),))


def test_a_load_is_not_asked_for_by_another_service_or_with_another_unit_in_the_hand():
    assert card_of(runs=(run(LOAD_REQUESTED),), session=replace(SCANNED, process="before:1")).state == "recorded"
    assert card_of(runs=(run(LOAD_REQUESTED),), session=LineSession(3, "o1")).state == "hand"
    assert card_of(runs=(run(LOAD_REQUESTED),), session=waits("A2", "o1")).state == "armed"


def test_a_weight_that_lies_on_the_unit_is_named_before_what_comes_next():
    view = card_of(runs=(run(UNIT_DONE, OrderKind.LOAD),))
    assert view.state == "pass" and view.details[0] == TRANSLATE("line.weight_off")
    asks = replace(LOT, rules=LineRules(loads=(KnownLoad(0.0), KnownLoad(2.0))))
    armed = card_of(session=waits(), lot=asks)
    assert TRANSLATE("line.no_weights") in armed.details


def test_a_run_goes_before_a_scan_and_a_stop_before_both():
    running = SITUATIONS["running"]
    assert card_of(**running, session=waits("A2", "o1")).state == "running"
    assert card_of(**SITUATIONS["stopped"], session=waits("A2", "o1")).state == "stopped"


def test_a_golden_unit_may_be_pressed_while_the_gate_is_closed():
    closed = heartbeat(StationState.CLOSED)
    golden = card_of(heartbeat=closed, session=waits("G1", is_golden=True))
    assert golden.state == "armed_golden" and golden.tone != card_of(session=waits()).tone
    assert card_of(heartbeat=closed, session=waits()).state == "closed"


def test_a_unit_that_waits_stands_there_and_not_the_result_of_the_one_before():
    assert card_of(runs=(run(),), session=waits("A2", "o1")).serial == "A2"
    assert card_of(runs=(run(),), session=waits("A2", "an older run")).state == "pass"


def test_an_empty_fixture_is_reported():
    message = reason("rig.aborted", why=reason("rig.no_contact", deepest_mm=40.0), state=Reason("left.lifted"))
    empty = replace(ERROR, code="E-SAFETY", message=(message,))
    view = card_of(heartbeat=heartbeat(StationState.STOPPED, reasons=(message,)), runs=(run(empty),))
    assert view.instruction == TRANSLATE("code.no_contact")


def test_a_good_unit_shows_its_error_and_nothing_of_how_the_limit_was_found():
    message = (
        "predicted RMSE 0.07 N (95 %: 0.05 to 0.1) is within the limit 0.2 N (no limit was stated: 3 x the source's"
    )
    runs = (run(replace(UNIT_DONE, message=message)),)
    results = (replace(result("pass")[0], predicted_rmse=0.0712),)
    assert card_of(runs=runs, results=results).details == (TRANSLATE("line.result", rmse="0.0712 N"),)
    limited = replace(LOT, lot=replace(LOT.lot, limit_rmse=0.2))
    assert card_of(runs=runs, results=results, lot=limited).details == (
        TRANSLATE("line.result.limit", rmse="0.071 N", limit="0.2 N"),
    )


def test_a_computer_that_stood_still_is_no_device_that_does_not_answer():
    message = reason("rig.aborted", why=reason("rig.host_paused", seconds=7.5), state=Reason("left.lifted"))
    silent = replace(ERROR, code="E-SILENT", message=(message,))
    view = card_of(heartbeat=heartbeat(StationState.STOPPED, reasons=(message,)), runs=(run(silent),))
    assert view.instruction == TRANSLATE("code.host_paused") and "7.5 s" in view.details[0]


LOOSE = reason(
    "masked.spike", count=2, first=reason("part.value_at", place=reason("part.at_time", at=12.34), value=9.0)
)
SHORT_TEXTS = {
    "a loose cable": (LOOSE, "12.3"),
    "too much of it": (reason("samples_missing", observed=LOOSE, share=0.4, windows=0.5), "12.3"),
    "a fit of the lot": (reason("lot_fit.open", number=2, count=7), "7"),
}


@pytest.mark.parametrize("language", texts.LANGUAGES)
@pytest.mark.parametrize(("why", "number"), SHORT_TEXTS.values(), ids=SHORT_TEXTS)
def test_the_short_text_of_the_line_has_the_time_and_the_count_that_help(why, number, language):
    translate = partial(texts.text, language)
    view = line_view(line_status(runs=(run(replace(UNIT_DONE, verdict="retest", message=(why,))),)), "", translate)
    assert number in view.details[0] and len(view.details[0]) < 80
    assert view.reason_details == (render_reason(why, translate),)


@pytest.mark.parametrize(("language", "who"), [("en", "engineer"), ("ko", "엔지니어")])
def test_without_a_limit_the_line_says_who_states_it(language, who):
    why = reason(
        "no_limit", source=Reason("part.measured"), rmse=0.1, unit="N", share=0.02, lower=0.05, upper=0.2, level=0.95
    )
    unit_done = run(replace(UNIT_DONE, verdict="conditional", message=(why,)))
    assert who in line_view(line_status(runs=(unit_done,)), "", partial(texts.text, language)).details[0]


NEAR = reason("stuck", seconds=2.5)


def test_a_card_and_its_chip_say_what_every_page_says_of_the_unit_now():
    audited = UnitResult("A1", "fail", (NEAR,), NOW)
    view = card_of(runs=(run(),), unit_statuses={"A1": audited})
    assert (view.state, view.word, view.chips[0].word) == ("fail", "FAIL", "FAIL")
    assert view.details[0] == TRANSLATE("plainly.stuck") and TRANSLATE("verdict.pass") in view.details[1]
    assert view.reason_details == (str(NEAR),)


def test_a_run_that_decided_nothing_shows_no_older_verdict():
    old = UnitResult("A1", "pass", (), NOW - timedelta(days=1))
    unjudged = run(replace(UNIT_DONE, verdict=""))
    assert card_of(runs=(unjudged,), unit_statuses={"A1": old}).state == "recorded"
    assert card_of(runs=(unjudged,), unit_statuses={"A1": replace(old, made_at=NOW)}).state == "pass"


def test_of_several_units_of_one_run_the_worst_is_shown():
    results = {f"A1-{k}": UnitResult(f"A1-{k}", word, (), NOW) for k, word in ((1, "pass"), (2, "conditional"))}
    assert card_of(runs=(run(),), unit_statuses=results).state == "conditional"


@pytest.mark.parametrize("language", texts.LANGUAGES)
def test_line_and_office_have_one_word_for_a_verdict(language):
    translate = partial(texts.text, language)
    for word in Verdict:
        now = run(replace(UNIT_DONE, verdict=str(word)))
        view = line_view(line_status(runs=(now,), results=result(str(word))), "", translate)
        assert view.word == view.chips[0].word == translate(f"verdict.{word}").upper()


def test_another_network_is_reported_until_a_unit_was_pressed_with_it():
    released = replace(NETWORK, since=NOW, actor="Quinn", reason="half the error")
    lot = replace(LOT, network=released)
    assert "Quinn: half the error" in card_of(lot=lot, runs=(run(),)).details[-1]
    newer = replace(run()[0], created=NOW + timedelta(minutes=1)), UNIT_DONE
    assert not any("Quinn" in line for line in card_of(lot=lot, runs=(newer,)).details)


def test_a_badge_is_marked_as_one_and_says_when_it_has_ended():
    badged = LineSession(1, operator="Lee", badged_at=NOW)
    here = line_status(session=badged)
    assert dict(line_view(here, "", TRANSLATE).cells)[TRANSLATE("role.operator")] == TRANSLATE("line.badge", name="Lee")
    assert dict(line_view(here, "Quinn", TRANSLATE).cells)[TRANSLATE("role.operator")] == "Quinn"
    ended = replace(here, now=NOW + timedelta(hours=11), heartbeat=None)
    assert dict(line_view(ended, "", TRANSLATE).cells)[TRANSLATE("role.operator")] == TRANSLATE(
        "line.badge.over", name="Lee"
    )


def test_every_sentence_about_a_scan_ends_with_the_next_run():
    session = LineSession(3, None, note=Note("scan_first", run="o1"))
    assert views_line.render_note(line_status(runs=(run(),), session=session), TRANSLATE) == (
        TRANSLATE("note.scan_first"),
        True,
    )
    assert views_line.render_note(
        line_status(active=run(replace(UNIT_DONE, state=RunState.RUNNING)), session=session), TRANSLATE
    )
    later = replace(run()[0], order_id="o2"), UNIT_DONE
    assert views_line.render_note(line_status(runs=(later, run()), session=session), TRANSLATE) is None


def test_a_stop_names_what_happened_what_to_do_and_its_code():
    view = card_of(**SITUATIONS["stopped"])
    assert view.instruction == TRANSLATE("code.E-SILENT")
    assert view.details == (ERROR.text, TRANSLATE("line.code", code="E-SILENT"))


def test_a_station_that_stopped_between_runs_does_not_blame_the_last_run():
    stopped_heartbeat = heartbeat(StationState.STOPPED, reasons=("the readout is gone",))
    view = card_of(heartbeat=stopped_heartbeat, runs=(run(ERROR),))
    assert view.details == ("the readout is gone",) and view.instruction == TRANSLATE("line.stopped.do")


def test_every_code_of_the_station_has_its_instruction_in_every_language():
    for language in texts.catalogue().values():
        assert {f"code.{code}" for code in CODES.values()} <= set(language)


def test_the_bar_tells_station_lot_product_operator_count_and_yield():
    station, *others = (value for _, value in card_of().cells)
    assert station.startswith("line-1") and TRANSLATE("station.state.ready") in station
    assert others == ["L1", "eGaIn pad", "Kim", "4 / 6", "75.0 %"]
    # A stated target goes before the number of known units.
    lot = replace(LOT, rules=LineRules(target=500))
    assert dict(card_of(lot=lot).cells)[TRANSLATE("line.cell.units")] == "4 / 500"
    # A unit that waits for evidence was pressed, and is no reject.
    cells = dict(card_of(lot=replace(LOT, counts={"conditional": 6})).cells)
    assert (cells[TRANSLATE("line.cell.units")], cells[TRANSLATE("line.cell.yield")]) == ("6", "–")


def test_a_stop_of_the_station_is_no_reject_among_the_last_units():
    chips = card_of(runs=(run(ERROR, serial="A2"), run())).chips
    assert [(chip.serial, chip.tone) for chip in chips] == [("A2", "stopped"), ("A1", "pass")]
    # At most fourteen are shown, and none of another lot.
    other = replace(run()[0], lot_id="L9"), UNIT_DONE
    chips = card_of(runs=(other, *(run(serial=f"A{k}") for k in range(30)))).chips
    assert len(chips) == 14 and chips[0].serial == "A0"


def test_a_question_shows_the_old_result():
    view = card_of(**SITUATIONS["ask"])
    assert TRANSLATE("verdict.pass") in view.instruction and view.details == ("because",)


def test_a_running_view_has_phase_remaining_time_and_signal():
    signal = Signal((0.0, 0.1), (1.0, 1.1), (0.0, 0.2))
    progress = Progress("o1", RunState.RUNNING, "pressing", 0.4, 100.0, signal=signal)
    view = card_of(active=run(progress))
    assert (view.phase, view.fraction, view.signal) == ("pressing", 0.4, signal) and "2 min" in view.remaining
    # A phase that no text is for stands as the station says it.
    assert card_of(active=run(replace(progress, phase="polishing"))).phase == "polishing"


def test_without_the_registry_the_screen_says_how_many_results_wait():
    view = away_view(12, "Kim", TRANSLATE)
    assert view.state == "away" and "12" in view.details[0]


def test_what_comes_from_outside_is_shown_as_text():
    evil = "<script>alert(1)</script>"
    view = replace(
        card_of(runs=(run(serial="A1"),)),
        serial=evil,
        details=(evil,),
        reason_details=(evil,),
        cells=((evil, evil),),
        conditions=(Condition(evil, False, evil),),
        chips=(views_line.Chip(evil, "pass", evil),),
    )
    html = [
        line_card.card_html(view, evil),
        line_card.cells_html(view),
        line_card.conditions_html(view, evil),
        line_card.chips_html(view, evil, evil),
        line_card.note_html(evil, True),
    ]
    assert "<script>" not in "".join(html)


def test_every_action_has_a_key_and_a_label():
    assert {command for state in STATES.values() for command in state.actions} == set(KEYS)
    assert all(f"line.action.{command}" in texts.catalogue()["en"] for command in KEYS)


def luminance(colour: str) -> float:
    channels = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one: str, other: str) -> float:
    """Contrast ratio of two colours (WCAG 2.1, definition of contrast ratio)."""
    high, low = sorted((luminance(one), luminance(other)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def test_words_stand_out_on_the_background_of_every_state():
    css = Path(line_card.__file__).with_suffix(".css").read_text()
    backgrounds = dict(re.findall(r"\.sc-(\w+) \{ background: (#\w{6}); \}", css))
    of_verdicts = dict(re.findall(r"\.sc-(\w+) \{ background: var\(--sc-verdict-(\w+)\); \}", css))
    assert {state.tone for state in STATES.values()} <= {*backgrounds, *of_verdicts}
    assert all(contrast("#FFFFFF", background) >= 4.5 for background in backgrounds.values())
    assert all(contrast(palette.VERDICT_INK, palette.VERDICT[one]) >= 4.5 for one in of_verdicts.values())


@pytest.mark.parametrize(
    ("colours", "backgrounds"), [(palette.LIGHT, ("#FFFFFF", "#F1F4F7")), (palette.DARK, ("#11181F", "#1B252E"))]
)
def test_texts_of_the_page_stand_out_in_both_themes(colours, backgrounds):
    for background in backgrounds:
        assert all(contrast(getattr(colours, name), background) >= 4.5 for name in ("text", "soft", "good", "bad"))
