"""What a station, its gate and the registry say is a code with values, said in the language of the screen."""

import ast
import json
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from functools import partial
from pathlib import Path
from string import Formatter

import pytest

import softcal.core.errors
from softcal.app.texts.catalogue import LANGUAGES, catalogue, text
from softcal.app.texts.reasons import PREFIX, render_reason
from softcal.core.errors import NoReply, SoftcalError
from softcal.core.messages import rig_sentences
from softcal.core.messages.reason import ENGLISH, PLAIN, Reason, pack_reasons, plain, reason, root_of
from softcal.core.operation.observation import FOLLOWED, JUMPED, ON_HOLD, ON_TRIAL, UNWATCHED
from softcal.core.operation.uncertainty import (
    JUMP,
    MOVED_WHILE_LEARNT,
    OPEN,
    QUEUE,
    REST_ELSEWHERE,
    UNCOMPARED,
    with_remedy,
)
from softcal.core.orders import Condition, Heartbeat, OrderKind, Progress, RunState, StationState
from softcal.core.quality.gate import CellAtGate, GoldenCheck, RigStatus, StationStatus, may_run
from softcal.db.connection import open_registry
from softcal.station.device_names import device_label
from softcal.station.messages import PAGES as DRIVER_PAGES
from softcal.station.wire.frames import gcl2, grbl, zaber

KOREAN, ENGLISH_WORDS = partial(text, "ko"), partial(text, "en")
SENTENCES = {
    **rig_sentences.SENTENCES,
    **{code: render_reason for page in DRIVER_PAGES.values() for code, render_reason in page.items()},
}
CODES_OF_DEVICES = (grbl.ALARMS, grbl.ERRORS, zaber.WARNINGS, gcl2.ERRORS)
ROOT = Path(softcal.core.errors.__file__).parents[1]
FILES = sorted(path for package in ("station", "app", "db", "core") for path in (ROOT / package).rglob("*.py"))
ERRORS = {"StageOnHold", "Cancelled", "StoppedByHand", "ZeroMoved"} | {
    name
    for name in dir(softcal.core.errors)
    if name[0].isupper() and name.endswith(("Error", "Refused", "Reply", "Stop"))
}


def calls(path: Path) -> Iterator[tuple[ast.Call, str]]:
    """Yield every call of a plain name in a file, with that name."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            yield node, node.func.id


def code_and_values(call: ast.Call) -> tuple[str, set[str]] | None:
    """Return code and names of the values of a reason that is made in place; None for one that is passed on."""
    # An item of the self-test is given the code of what was found after its device and what was looked at.
    code, *rest = call.args[2:] if ast.unparse(call.func) == "_item" else call.args
    if not isinstance(code, ast.Constant):
        return None
    names = {str(key.value) for table in rest if isinstance(table, ast.Dict) for key in table.keys}
    names |= {str(keyword.arg) for keyword in call.keywords}
    # `**shared`: whatever else the sentence needs.
    return str(code.value), (names - {"None"}) | (
        placeholders_of(ENGLISH.get(str(code.value), "")) if "None" in names else set()
    )


def placeholders_of(sentence: str) -> set[str]:
    """Return the names in the braces of a sentence."""
    return {name for _, name, _, _ in Formatter().parse(sentence) if name}


def test_every_reason_that_is_given_has_its_sentence_and_all_of_its_values() -> None:
    wrong = [
        (str(path.relative_to(ROOT)), call.lineno, code)
        for path in FILES
        for call, name in calls(path)
        if (name in ("reason", "Reason") or (name, path.stem) == ("_item", "self_test"))
        and call.args
        and (reasons_of_call := code_and_values(call)) is not None
        for code, values in [reasons_of_call]
        # The cure of a setting is given its number where the setting is known.
        if code not in ENGLISH or (values != placeholders_of(ENGLISH[code]) and code != "grbl.safe.acceleration")
    ]
    assert wrong == []


def test_every_sentence_is_rendered_in_every_language_with_the_same_values() -> None:
    other = [
        (language, code)
        for language in LANGUAGES
        for code, sentence in SENTENCES.items()
        if placeholders_of(catalogue()[language][f"{PREFIX}{code}"]) != placeholders_of(sentence)
    ]
    assert other == []


def test_every_sentence_is_given_somewhere() -> None:
    source = "\n".join(path.read_text(encoding="utf-8") for path in FILES if path.name != "rig_sentences.py")
    of_devices = {why.code for table in CODES_OF_DEVICES for why in table.values()}
    assert [code for code in SENTENCES if f'"{code}"' not in source and code not in of_devices] == []


SAME = {code for code, sentence in SENTENCES.items() if not re.search(r"[a-z]{3,}", re.sub(r"\{[^}]*\}", "", sentence))}
"""Sentences of numbers and units alone."""

KEYS = {"name", "true", "force", "stage", "safety", "without_cell", "cycles", "esm"}
"""Words of the station file: they stand in it in English."""


def test_every_sentence_with_words_is_korean_in_korean(english_in: Callable[[str], list[str]]) -> None:
    for code in SENTENCES.keys() - SAME:
        korean = re.sub(r"\{[^}]*\}", "1", catalogue()["ko"][f"{PREFIX}{code}"])
        korean = re.sub(r"[a-z_]{2,}", lambda word: "" if word[0] in KEYS else word[0], korean)
        assert re.search("[가-힣]", korean) and english_in(korean) == [], code


def test_no_error_of_the_station_is_a_sentence() -> None:
    text_nodes = ast.JoinedStr | ast.Constant
    raised = [
        call
        for path in FILES
        if "station" in path.relative_to(ROOT).parts
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call)
        for call in [node.exc]
    ]
    sentences = [
        ast.unparse(call)
        for call in raised
        if isinstance(call.func, ast.Name)
        and call.func.id in ERRORS
        and call.args
        and isinstance(call.args[0], text_nodes)
    ]
    assert sentences == []


def test_no_text_is_taken_apart_to_be_said() -> None:
    for path in (ROOT / "app" / "texts").glob("*.py"):
        tree = ast.parse(path.read_text())
        imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
        taken_apart = {n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute)} & {"split", "partition", "match"}
        assert "re" not in imported and not taken_apart


def test_every_code_of_a_device_is_explained_in_korean(english_in: Callable[[str], list[str]]) -> None:
    assert [why for table in CODES_OF_DEVICES for why in table.values() if english_in(render_reason(why, KOREAN))] == []


NOW = datetime(2026, 3, 2, 9, 0, tzinfo=UTC)
GOOD = StationStatus(
    NOW, CellAtGate("K-17", date(2027, 1, 1), 20.0, 0.02), 12.0, NOW, GoldenCheck(NOW, "G1", True),
    rig=RigStatus(timedelta(hours=2), is_homed=True),
)  # fmt: skip
HOMING = reason("grbl.homing_failed", why=grbl.Alarm(9).reason)
BAD = StationStatus(
    NOW, CellAtGate("K-17", date(2026, 1, 1), 9.0, 0.02), 12.0, NOW, GoldenCheck(NOW, "G1", False),
    rig=RigStatus(homing_fault=HOMING, zero_return_N=1.0),
)  # fmt: skip
FAULT = reason("rig.not_zero", zero_N=3.0, allowed_N=0.5)
GATES = {
    "good": GOOD,
    "bad": BAD,
    "nothing known": replace(GOOD, certificate=None, golden=None, rig=RigStatus()),
    "zero": replace(GOOD, rig=RigStatus(zero_fault=FAULT)),
}


@pytest.mark.parametrize("status", GATES.values(), ids=GATES)
def test_every_condition_of_the_gate_is_rendered_in_korean(
    status: StationStatus, english_in: Callable[[str], list[str]]
) -> None:
    conditions = may_run(status, OrderKind.UNIT).conditions
    assert len(conditions) >= 5
    for condition in conditions:
        assert english_in(render_reason(condition.name, KOREAN) + " " + render_reason(condition.says, KOREAN)) == []
        assert render_reason(condition.name, KOREAN) != str(condition.name)


def test_an_error_is_english_as_text_and_korean_on_a_screen() -> None:
    error = NoReply(reason("rig.no_answer", device=device_label("stage", "/dev/ttyACM0"), within_s=0.5))
    assert str(error) == "stage (/dev/ttyACM0): no answer within 0.5 s; check cable, power and baud rate"
    korean = render_reason(error.reason, KOREAN)
    assert korean == "스테이지 (/dev/ttyACM0): 0.5초 안에 응답 없음; 케이블, 전원, 통신 속도를 확인하십시오"


def test_a_cause_within_a_message_is_reported_too(english_in: Callable[[str], list[str]]) -> None:
    stopped = reason("rig.aborted", why=FAULT, state=Reason("left.lifted"))
    korean = render_reason(reason("rig.stopped", why=stopped), KOREAN)
    assert english_in(korean) == [] and "무부하 값 3 N" in korean and "작업 중단" in korean
    assert root_of(stopped) == FAULT and root_of(FAULT) == FAULT


def test_a_device_of_another_maker_keeps_its_name() -> None:
    assert render_reason(device_label("spectrometer"), KOREAN) == "spectrometer"


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_a_number_that_is_none_never_keeps_a_stop_from_being_said(value: float) -> None:
    why = reason("rig.force", force_N=value, coming_N=1.0, limit_N=5.0)
    assert f"force {value} N, 1.00 N by the time" in str(why)
    assert str(value) in render_reason(Reason.parse(json.loads(json.dumps(why.to_json(), allow_nan=False))), KOREAN)


def test_what_a_station_says_crosses_the_registry_with_its_values(tmp_path: Path) -> None:
    stopped = reason("rig.aborted", why=FAULT, state=Reason("left.lifted"))
    gate = tuple(may_run(BAD, OrderKind.UNIT).conditions)
    heartbeat = Heartbeat("s1", StationState.STOPPED, NOW, (stopped,), "host:1", gate=gate)
    with open_registry(f"sqlite:///{tmp_path / 'registry.db'}") as registry:
        registry.order_queue.write_heartbeat(heartbeat)
        assert registry.order_queue.heartbeat("s1") == heartbeat
    message = Progress("o1", RunState.ERROR, message=pack_reasons([stopped])).message  # type: ignore[arg-type]
    assert message == (stopped,) and "무부하 값 3 N" in render_reason(message[0], KOREAN)


def test_a_row_of_an_older_version_is_shown_as_it_stands() -> None:
    old = "stage: no answer within 0.5 s; check cable, power and baud rate"
    assert Progress("o1", RunState.ERROR, message=old).message == (plain(old),)  # type: ignore[arg-type]
    heartbeat = Heartbeat("s1", StationState.STOPPED, NOW, (old,), gate=(Condition("homing", True, "homed"),))  # type: ignore[arg-type]
    assert render_reason(heartbeat.reasons[0], KOREAN) == old and heartbeat.gate[0].says.code == PLAIN


def test_every_order_every_end_of_a_run_and_every_step_in_use_has_a_name() -> None:
    steps = ("start", FOLLOWED, ON_HOLD, ON_TRIAL, JUMPED, UNWATCHED)
    codes = [f"order.{kind}" for kind in OrderKind] + [f"run.{state}" for state in RunState]
    codes += [f"event.{step}" for step in steps]
    assert [(language, name) for language in LANGUAGES for name in codes if name not in catalogue()[language]] == []


@pytest.mark.parametrize("module", ["tracker", "stream_estimator"])
def test_every_reason_to_calibrate_again_has_its_korean_text(
    module: str, english_in: Callable[[str], list[str]]
) -> None:
    tree = ast.parse((ROOT / "core" / "operation" / f"{module}.py").read_text())
    alarm_texts = [
        n.value for n in ast.walk(tree) if isinstance(n, ast.Assign) and "alarm" in ast.unparse(n.targets[0])
    ]
    alarm_texts += [n.value for f in ast.walk(tree) if isinstance(f, ast.FunctionDef) and f.name == "_alarm"
             for n in ast.walk(f) if isinstance(n, ast.Return)]  # fmt: skip
    phrases = {
        n.value for value in alarm_texts for n in ast.walk(value) if isinstance(n, ast.Constant) and " " in str(n.value)
    }
    assert len(phrases) >= 1
    assert [phrase for phrase in phrases if english_in(KOREAN(f"adapt.{phrase}"))] == []


def test_every_cause_of_an_alarm_has_its_text() -> None:
    for why in (UNCOMPARED, MOVED_WHILE_LEARNT, REST_ELSEWHERE, JUMP, OPEN, QUEUE):
        assert catalogue()["en"][f"adapt.{with_remedy(why)}"] == with_remedy(why)
        assert KOREAN(f"adapt.{with_remedy(why)}") not in (with_remedy(why), f"adapt.{with_remedy(why)}")


def test_an_error_survives_the_way_between_processes() -> None:
    import pickle

    error = pickle.loads(pickle.dumps(NoReply(FAULT)))
    assert isinstance(error, SoftcalError) and error.reason == FAULT
