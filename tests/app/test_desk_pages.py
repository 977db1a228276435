"""The engineer's pages, drawn in process: what they show, what they refuse in words, and what reaches the registry."""

import os
import socket
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from softcal.app.charts.palette import LIGHT
from softcal.app.charts.station import profile_figure
from softcal.app.connect.stations import station_json
from softcal.app.gap.page_cases import practise
from softcal.app.line.status import Screen, read_line
from softcal.app.texts.catalogue import text
from softcal.app.ui.panels import drop_empty_columns
from softcal.app.views.line import line_view
from softcal.app.views.lot import lot_view
from softcal.app.views.station import bounds
from softcal.app.views.wall import wall_view
from softcal.core.lot import UnitKey
from softcal.core.messages.reason import Reason
from softcal.core.orders import Heartbeat, OrderKind, RunState, StationState
from softcal.core.profiles import BUILT_IN
from softcal.core.quality.line_rules import LineRules
from softcal.db.connection import open_registry
from softcal.db.entries import CellCertificate, GoldenRun

pytestmark = pytest.mark.usefixtures("separate_data_folder")


def press(screen, key: str, timeout: float | None = None, **values: str) -> None:
    """Press the button of a page that bears a text of the catalogue."""
    label = text("en", key, **values)
    next(button for button in screen.button if button.label == label).click().run(timeout=timeout)


PAGES = ("lots", "lot", "unit", "gap", "station", "settings")


@pytest.mark.parametrize("page", PAGES)
def test_an_empty_registry_gives_every_page_a_way_to_begin_in_korean_too(tmp_path: Path, show, page: str) -> None:
    screen = show(f"sqlite:///{tmp_path / 'new.db'}", page, lang="ko")
    assert any("가" <= letter <= "힣" for letter in screen.title[0].value)
    assert not screen.error
    assert screen.info or screen.button  # a button or a form is the way to begin


def test_a_limit_is_set_with_its_reason_and_lands_in_the_audit_trail(calibrated: str, show) -> None:
    screen = show(calibrated, "lot", tab="limits", lot="small")
    screen.toggle[0].set_value(False).run()
    screen.number_input[0].set_value(0.25).run()
    screen.text_input(key="reason-text-limit-small-1").set_value("drawing D 117 rev. B")
    screen.button[0].click().run()
    assert "0.25" in screen.success[0].value
    with open_registry(calibrated) as registry:
        limit, rows = registry.lots.limit("small"), registry.trail.rows()
        units = [unit for unit in registry.lots.units("small") if unit.revision is not None]
        limits = [registry.calibrations.get(unit.serial, lot_id="small").state.limit.maximum_rmse for unit in units]
    assert limit is not None and limit.rmse == 0.25
    assert ("Erin", "set_limit", "drawing D 117 rev. B") in [(row.actor, row.action, row.reason) for row in rows]
    assert limits and set(limits) == {0.25}


def test_a_limit_somebody_else_changed_meanwhile_is_not_overwritten(calibrated: str, show) -> None:
    with open_registry(calibrated) as registry:
        registry.lots.set_limit("small", 0.3, reason="first")
    screen = show(calibrated, "lot", tab="limits", lot="small")
    with open_registry(calibrated) as registry:
        registry.lots.set_limit("small", 0.2, reason="second", actor="Quinn")
    screen.number_input[0].set_value(0.25).run()
    screen.text_input(key="reason-text-limit-small-2").set_value("drawing D 117 rev. B")
    screen.button[0].click().run()
    assert "0.2" in screen.error[0].value and "Quinn" in screen.error[0].value
    with open_registry(calibrated) as registry:
        assert registry.lots.limit("small").rmse == 0.2


def test_the_rules_of_the_line_are_set_with_their_reason_and_land_in_the_audit_trail(calibrated: str, show) -> None:
    screen = show(calibrated, "lot", tab="limits", lot="small")
    screen.text_input(key="rules-pattern-small-0").set_value(r"A\d")
    screen.number_input(key="rules-target-small-0").set_value(40)
    screen.number_input(key="rules-fail-small-0").set_value(0)
    screen.text_input(key="reason-text-rules-small-0").set_value("order of the customer")
    press(screen, "rules.set")
    assert not screen.error and screen.success
    with open_registry(calibrated) as registry:
        rules, row = registry.lots.line_rules(registry.lots.get("small")), registry.trail.rows()[-1]
    assert (rules.serial_pattern, rules.target, rules.retests["fail"], rules.retests["retest"]) == (r"A\d", 40, 0, 3)
    assert (row.actor, row.action, row.reason) == ("Erin", "set_rules", "order of the customer")
    assert screen.table[-1].value[text("en", "rules.target")].tolist() == [40]


def test_rules_that_are_none_and_rules_changed_meanwhile_are_refused_in_words(calibrated: str, show) -> None:
    screen = show(calibrated, "lot", tab="limits", lot="small")
    screen.text_input(key="rules-pattern-small-0").set_value("A(")
    screen.text_input(key="reason-text-rules-small-0").set_value("order of the customer")
    press(screen, "rules.set")
    assert "A(" in screen.error[0].value
    with open_registry(calibrated) as registry:
        registry.lots.set_line_rules("small", LineRules(target=7), reason="first")
    other = show(calibrated, "lot", tab="limits", lot="small")
    with open_registry(calibrated) as registry:
        registry.lots.set_line_rules("small", LineRules(target=9), reason="second", actor="Quinn")
    other.number_input(key="rules-target-small-1").set_value(40)
    other.text_input(key="reason-text-rules-small-1").set_value("order of the customer")
    press(other, "rules.set")
    assert "Quinn" in other.error[0].value
    with open_registry(calibrated) as registry:
        assert registry.lots.line_rules(registry.lots.get("small")).target == 9


def test_a_network_is_trained_as_a_job_and_listed(calibrated: str, show, jobs_at_once) -> None:
    screen = show(calibrated, "lot", tab="networks", lot="small")
    networks_before = len(screen.table[0].value)
    screen.text_input(key="train-hidden").set_value("8")
    screen.number_input(key="train-epochs").set_value(5)
    press(screen, "networks.train.do", timeout=120)
    assert not screen.error and screen.success
    assert len(screen.table[0].value) == networks_before + 1


def test_networks_and_families_are_compared_on_the_lot(calibrated: str, show, jobs_at_once) -> None:
    screen = show(calibrated, "lot", tab="networks", lot="small")
    press(screen, "networks.compare.do", timeout=120)
    assert not screen.error
    table = screen.table[-1].value
    assert set(table["Map"]) == {"auto", "affine"} and (table["Audited"] == 3).all()


@pytest.mark.long
def test_a_rollback_needs_a_reason_and_stays_in_the_history(calibrated: str, show) -> None:
    with open_registry(calibrated) as registry:
        state = registry.calibrations.get("A1").state
        fit = replace(state.fit, load_rms=1.01 * state.fit.load_rms)
        registry.calibrations.add("small", replace(state, fit=fit))
    screen = show(calibrated, "unit", tab="history", unit="A1")
    screen.text_input(key="reason-text-rollback-small/A1-1").set_value("wrong fixture in week 47")
    press(screen, "unit.rollback.do")
    assert screen.success
    with open_registry(calibrated) as registry:
        assert registry.calibrations.get("A1").rolled_back_to == 1
        assert registry.trail.rows()[-1].reason == "wrong fixture in week 47"


@pytest.mark.parametrize("is_doubted", [False, True])
def test_a_rollback_does_what_its_page_said_before(calibrated: str, show, is_doubted: bool) -> None:
    def verdicts(registry) -> dict[str, str | None]:
        return {unit.serial: unit.verdict for unit in registry.lots.units("small")}

    with open_registry(calibrated) as registry:
        state = registry.calibrations.get("A1").state
        suspicion = Reason("doubt.gain", {"gain": 0.01, "usual": 1.0, "others": 5}) if is_doubted else None
        fit = replace(state.fit, load_rms=1.01 * state.fit.load_rms)
        registry.calibrations.add("small", replace(state, fit=fit, suspect_audit=suspicion), decided_by="release")
        before = verdicts(registry)
    screen = show(calibrated, "unit", tab="history", unit="A1")
    listed = [cell[1:].partition("]")[0] for one in screen.table[1:] for cell in one.value.iloc[:, 0]]
    with open_registry(calibrated) as registry:
        assert verdicts(registry) == before, "a look changes nothing"
    screen.text_input(key="reason-text-rollback-small/A1-1").set_value("wrong fixture in week 47")
    press(screen, "unit.rollback.do")
    with open_registry(calibrated) as registry:
        after = verdicts(registry)
    assert listed == [serial for serial in after if after[serial] != before[serial]]
    assert bool(listed) == is_doubted


def test_a_certificate_is_typed_in_and_what_it_lacks_is_named(calibrated: str, show) -> None:
    screen = show(calibrated, "station", tab="cells")
    screen.text_input(key="cell-cell_serial").set_value("K1")
    screen.button[0].click().run()
    assert "number" in screen.error[0].value
    screen.text_input(key="cell-number").set_value("17")
    screen.date_input(key="cell-issued_on").set_value(date(2026, 1, 5))
    screen.date_input(key="cell-due_on").set_value(date(2099, 1, 5))
    screen.number_input(key="cell-capacity_N").set_value(20.0)
    screen.number_input(key="cell-uncertainty_N").set_value(0.02)
    screen.button[0].click().run()
    assert [error.value for error in screen.error] == [] and "17" in screen.success[0].value
    with open_registry(calibrated) as registry:
        assert registry.stations.certificate("K1", date(2026, 6, 1)) == CellCertificate(
            "K1", "17", "", date(2026, 1, 5), date(2099, 1, 5), 20.0, 0.02
        )


def test_golden_units_are_charted_with_their_failures(calibrated: str, show) -> None:
    with open_registry(calibrated) as registry:
        for k in range(10):
            at = datetime(2026, 5, 4, tzinfo=UTC) + timedelta(hours=8 * k)
            reasons = () if k != 9 else ("0.2 N is too much",)
            registry.stations.add_golden_run(
                GoldenRun("line-1", "small", "A1", at, 0.1 + 0.01 * (k % 3), "N", k != 9, reasons)
            )
    screen = show(calibrated, "station", tab="cells")
    assert any("A1" in line.value and text("en", "golden.failed") in line.value for line in screen.markdown)
    assert any("0.2 N is too much" in line.value for line in screen.caption)


def test_a_station_that_does_not_answer_gets_no_order(calibrated: str, show) -> None:
    heartbeat = Heartbeat("line-1", StationState.READY, datetime(2026, 5, 4, tzinfo=UTC), process="host:1")
    with open_registry(calibrated) as registry:
        registry.order_queue.write_heartbeat(heartbeat)
    screen = show(calibrated, "station")
    assert any(text("en", "station.state.silent") in line.value for line in screen.markdown)
    press(screen, "station.check")
    assert "line-1" in screen.error[0].value
    with open_registry(calibrated) as registry:
        assert registry.order_queue.runs("line-1") == []


def process_of(whose: str) -> str:
    """Return the name of a process: this one, one that cannot be (Linux numbers them up to 2^22), or another's."""
    return {"here": f"{socket.gethostname()}:{os.getpid()}", "gone": f"{socket.gethostname()}:{2**22 + 1}"}.get(
        whose, whose
    )


@pytest.mark.parametrize(
    ("state", "age_s", "process", "expected_word"),
    [
        # From a clock that is a little ahead: so nobody waits too long for what reads it.
        *((state, -25, "another:1", str(state)) for state in StationState),
        (StationState.READY, -60, "another:1", "silent"),
        (StationState.READY, 5, "another:1", "silent"),
        (StationState.READY, -25, "gone", "silent"),
        (StationState.READY, 4, "here", "ready"),
        (StationState.OFF, 5, "gone", "off"),
    ],
)
def test_every_screen_and_interface_has_one_word_for_a_station(
    calibrated, show, state, age_s, process, expected_word
) -> None:
    def make_heartbeat() -> Heartbeat:
        return Heartbeat("line-1", state, datetime.now(UTC) - timedelta(seconds=age_s), process=process_of(process))

    translate = partial(text, "en")
    with open_registry(calibrated) as registry:
        registry.order_queue.write_heartbeat(make_heartbeat())
        at_line = line_view(read_line(registry, Screen()), "", translate).cells[0][1]
        on_wall = [word for _, word, _ in wall_view(registry, lot_view(registry, "small"), (), translate).stations]
        assert station_json(registry, make_heartbeat())["state"] == expected_word
        # As old as before when the page reads it, however long the others took.
        registry.order_queue.write_heartbeat(make_heartbeat())
    word = translate(f"station.state.{expected_word}")
    assert at_line == f"line-1 · {word}" and on_wall == ([] if expected_word == "off" else [word])
    assert any(f"**{word}**" in line.value for line in show(calibrated, "station").markdown)


def test_the_source_is_ordered_from_a_station_that_answers(calibrated: str, show) -> None:
    with open_registry(calibrated) as registry:
        registry.order_queue.write_heartbeat(
            Heartbeat("line-1", StationState.READY, datetime.now(UTC), process="host:1")
        )
        screen = show(calibrated, "lots", tab="rig", lot="small")
        registry.order_queue.write_heartbeat(
            Heartbeat("line-1", StationState.READY, datetime.now(UTC), process="host:1")
        )
        press(screen, "source.step.2")
        (order, _), *_ = registry.order_queue.runs("line-1")
    assert (order.kind, order.serial, order.lot_id, order.actor) == (OrderKind.SOURCE, "A0", "small", "Erin")


def test_a_new_lot_with_a_bad_serial_is_refused_in_words(calibrated: str, show) -> None:
    screen = show(calibrated, "lots", tab="rig")
    screen.text_input[0].set_value("L 2")
    screen.text_input[1].set_value("../A0")
    press(screen, "source.add_lot")
    assert "../A0" in screen.error[0].value.replace("\\", "")
    with open_registry(calibrated) as registry:
        assert registry.lots.ids() == ["small"]


def test_a_profile_too_deep_for_the_station_is_marked(calibrated: str, show) -> None:
    screen = show(calibrated, "station", tab="profiles")
    assert not screen.error
    screen.number_input[0].set_value(9.0).run()
    assert "12 mm" in screen.error[0].value


def test_a_simulated_rig_is_found_and_its_station_file_given(calibrated: str, show, jobs_at_once) -> None:
    screen = show(calibrated, "station")
    screen.get_by_key("rig").set_value("simulated").run()
    press(screen, "setup.do", timeout=120)
    assert not screen.error and screen.success
    assert "[stage]" in screen.code[0].value


def _adapted(url: str) -> None:
    same = {"stream": "line 3", "event": "followed", "log_gain": 0.0, "shift_sd": 0.01, "log_gain_sd": 0.01}
    steps = [
        same
        | {"sample": 50 * k, "row": 50 * k, "t_s": float(k), "predicted_rmse": 0.1 + 0.01 * k}
        | {"gain": 1.0 - 0.001 * k, "offset": 0.001 * k, "shift": 0.01 * k}
        | ({"verdict": "held", "reason": "another use"} if k == 3 else {"verdict": "followed", "reason": ""})
        | {"alarm": "calibrate with a reference: 0.2 N" if k > 8 else ""}
        for k in range(12)
    ]
    with open_registry(url) as registry:
        registry.adaptations.add(UnitKey("small", "A2"), 1, steps)


def test_a_unit_in_use_shows_its_course_and_that_a_calibration_is_due(calibrated: str, show) -> None:
    _adapted(calibrated)
    screen = show(calibrated, "unit", tab="history", unit="small/A2")
    (line,) = [one.value for one in screen.markdown if text("en", "long_term.steps") in one.value]
    assert f"**{text('en', 'event.alarm')}**" in line and "**0.21" in line
    assert "0.2 N" in screen.warning[0].value


@pytest.mark.long
def test_a_case_is_diagnosed_and_read_on_the_page(calibrated: str, show, jobs_at_once) -> None:
    case = practise("usual")
    screen = show(calibrated, "gap", case=str(case))
    screen.checkbox(key="gap-calibration").check().run()
    screen.button(key="diagnose").click().run(timeout=180)
    assert not screen.error and len(screen.get("plotly_chart")) > 3
    with open_registry(calibrated) as registry:
        (job,) = registry.job_board.jobs("diagnose")
        errors = registry.job_board.job(job.job_id).result["calibration"]
    assert sum(f"**{errors['repaired']:.3g} N**" in one.value for one in screen.markdown) == 1
    headings = [heading.value for heading in screen.header]
    assert {text("en", "gap.where"), text("en", "gap.next")} <= set(headings)
    assert len(revealed(screen)) == 1


def revealed(screen) -> list[str]:
    """Ask what was hidden in a practice rig; return what the page says."""
    next(toggle for toggle in screen.toggle if toggle.label == text("en", "gap.truth")).set_value(True).run()
    return [line.value for line in screen.markdown if line.value.startswith(HIDDEN)]


HIDDEN = text("en", "gap.truth.is", causes="").split("**")[0]


@pytest.mark.long
def test_a_mistake_hidden_in_a_practice_rig_is_found_and_reported(calibrated: str, show, jobs_at_once) -> None:
    case = practise("mistakes")
    screen = show(calibrated, "gap", case=str(case))
    screen.button(key="diagnose").click().run(timeout=180)
    (mistake,) = revealed(screen)
    assert text("en", "gap.truth.mistake", mistake="|", channel="", runs="", run="").split("|")[0] in mistake


def store_diagnosis(url: str, case: Path, **content: object) -> None:
    """Register the diagnosis of a case that a job has made."""
    lists = {name: [] for name in ("where", "causes", "ambiguous_with", "missing_channels", "runs")}
    with open_registry(url) as registry:
        board = registry.job_board
        job = board.place("diagnose", {"case": str(case)}, "Erin")
        board.take(job)
        board.end(job, RunState.DONE, str(content["verdict"]), {"hidden_fraction": {}, "gap": {}} | lists | content)


def test_diagnoses_are_listed_newest_first_and_one_stays_at_its_address(calibrated: str, show, tmp_path: Path) -> None:
    nothing = {"predicted": None, "low": None, "high": None, "held_out": 0.5}
    for name, verdict in (("first", "no_gap"), ("second", "explained_in_part")):
        store_diagnosis(calibrated, tmp_path / name, verdict=verdict, shrink=nothing, next_experiment={})
    screen = show(calibrated, "gap")
    links = list(screen.table[0].value[text("en", "gap.case")])
    assert ["second" in links[0], "first" in links[1]] == [True, True]
    job = links[1].split("job=")[1].rstrip(")")
    store_diagnosis(calibrated, tmp_path / "first", verdict="unknown", shrink=nothing, next_experiment={})
    screen = show(calibrated, "gap", case=str(tmp_path / "first"), job=job)
    assert not screen.exception and not screen.error
    assert text("en", "gap.verdict.no_gap") in screen.header[0].value
    screen.selectbox(key="gap-beside").select_index(0).run()
    assert not screen.exception and text("en", "gap.verdict.unknown") in screen.header[1].value
    other = screen.query_params["with"]
    screen = show(calibrated, "gap", case=str(tmp_path / "first"), job=job, **{"with": other})
    assert text("en", "gap.verdict.unknown") in screen.header[1].value, "the address holds both"


@pytest.mark.long
def test_one_click_presses_the_proposed_experiment_on_the_simulated_rig(calibrated: str, show, jobs_at_once) -> None:
    case = practise("usual")
    proposed = {"profile": "rate_sweep", "why": "three speeds part creep from drift", "minutes": 2.0}
    nothing = {"predicted": None, "low": None, "high": None, "held_out": None}
    store_diagnosis(calibrated, case, verdict="ambiguous", shrink=nothing, next_experiment=proposed)
    screen = show(calibrated, "gap", case=str(case))
    press(screen, "gap.next.do", timeout=180)
    assert not screen.error and not screen.exception
    with open_registry(calibrated) as registry:
        job, *_ = registry.job_board.jobs("diagnose")
        result = registry.job_board.job(job.job_id).result
    request = {"case": str(case), "experiment": "rate_sweep"}
    assert (job.request, job.actor, job.state) == (request, "Erin", RunState.DONE)
    assert [run["profile"] for run in result["runs"] if run["name"] == "asked-1"] == ["rate sweep"]
    headings = [heading.value for heading in screen.header]
    assert any(text("en", f"gap.verdict.{result['verdict']}") in heading for heading in headings)


def test_what_no_cause_explains_is_described_on_the_page(calibrated: str, show, jobs_at_once) -> None:
    case = practise()
    shrink = {"predicted": 0.88, "low": 0.84, "high": 0.92, "held_out": 0.88}
    term = {"place": "output_V", "variable": "load²", "standard_error": 4e-4, "unit": "V", "chosen": 0.75}
    residual = {"formula": ["output_V += -0.0515 V · load²"], "terms": [term], "beside": ["backlash"], "without": 0.17}
    residual |= {"kind": "empirical", "shrink": shrink, "load_N": 6.0, "depth_mm": 3.02}
    store_diagnosis(calibrated, case, verdict="unknown", shrink=shrink, next_experiment={}, residual=residual)
    screen = show(calibrated, "gap", case=str(case))
    assert not screen.error and not screen.exception
    assert text("en", "gap.left") in [heading.value for heading in screen.header]
    assert any("88.0 %" in line.value for line in screen.markdown)
    assert any("backlash" in line.value and "17.0 %" in line.value for line in screen.caption)


def test_an_empty_column_takes_no_space() -> None:
    rows = [{"a": 0, "why": "", "remark": ""}, {"a": 1, "why": "", "remark": "old"}]
    assert (
        drop_empty_columns(rows) == [{"a": 0, "remark": ""}, {"a": 1, "remark": "old"}] and drop_empty_columns([]) == []
    )


def test_a_profile_is_drawn_where_its_bound_counts_from() -> None:
    profile, start_mm = BUILT_IN["source"](np.random.default_rng(0), 3.5), 4.0
    figure = profile_figure(profile, start_mm, 12.0, 10.0, LIGHT, partial(text, "en"))
    (depth, _) = bounds(profile, 12.0, 10.0, start_mm)
    assert max(figure.data[0].y) == pytest.approx(depth.value, abs=0.01)
