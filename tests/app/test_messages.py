"""Everything a station can say, its gate's conditions and its stops, is said in the language of the screen."""

import ast
import inspect
import re
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from functools import partial
from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType

import pytest

from softcal.app.line import gate_facts, pressed_run
from softcal.app.line import host as station_host
from softcal.app.texts.catalogue import LANGUAGES, catalogue, text
from softcal.app.texts.reasons import told
from softcal.core.orders import OrderKind, RunState
from softcal.core.quality import gate as station_gate
from softcal.core.quality.gate import CellAtGate, GoldenCheck, RigFacts, StationFacts, may_run
from softcal.core.use import tracker as drift
from softcal.db import people
from softcal.station import (
    acquisition,
    bench,
    command,
    contact,
    drivers,
    frames,
    link,
    motion,
    proof,
    recording,
    safety,
    self_test,
    service,
    spool,
    steps,
    watched,
)
from softcal.station.frames import gcl2, grbl, zaber

KOREAN, ENGLISH = partial(text, "ko"), partial(text, "en")
MODULES = [
    *(station_gate, gate_facts, station_host, pressed_run, people, drift),
    *(acquisition, bench, command, contact, link, motion, proof, recording, safety, self_test, service, spool, steps),
    watched,
    *(
        import_module(f"{folder.__name__}.{m.name}")
        for folder in (drivers, frames)
        for m in iter_modules(folder.__path__)
    ),
]
NOT_SHOWN = (
    *("recorded without a reference", "is no spool of softcal", "pressed on", "is no Zaber command"),
    *("nobody has this PIN", "is none of"),
    # Keys of a station file, said to the engineer who wrote it.
    *("a number above 0 was expected", "a number in [", "a value in ", "known are", "force.counts_per_N is"),
    *("reads one channel", "readings a second are possible", "check [stage] in the station file"),
    # What `softcal station drivers` lists.
    *("text lines `", "stands under PC control", "the gauge on a", "grblHAL controllers", "weighing indicators that"),
    *("SCPI multimeters:", "Zaber stages, ASCII"),
)
"""Errors of a caller, and words for the audit trail and for lists."""

DECLARED = ("Get", "Set", "Control", "Measure", "get ", "set ")
"""A declared quantity of a driver begins so: its documentation and its command, no message."""

DEVICE, VALUE = re.compile(r"\0[^\0]*(name|label|sensor)\0:"), re.compile(r"\0[^\0]*\0")


def sentences(module: ModuleType) -> list[str]:
    """Return every text of three words or more in a module, with a device or a number in the place of each value."""
    tree = ast.parse(inspect.getsource(module))
    quiet = [node.value for node in ast.walk(tree) if isinstance(node, ast.Expr)]
    quiet += [part for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values]
    texts = [_filled(node) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr)]
    constants = (node for node in ast.walk(tree) if isinstance(node, ast.Constant) and node not in quiet)
    texts += [node.value for node in constants if isinstance(node.value, str)]
    phases = {key.removeprefix("phase.") for key in catalogue()["en"] if key.startswith("phase.")}
    return [
        found
        for found in texts
        if len(re.findall(r"[a-z]{2,}", found)) > 2
        and found not in phases
        and not found.startswith(DECLARED)
        and not any(part in found for part in NOT_SHOWN)
    ]


def _filled(sentence: ast.JoinedStr) -> str:
    made = "".join(
        part.value if isinstance(part, ast.Constant) else f"\0{ast.unparse(part.value)}\0" for part in sentence.values
    )
    return VALUE.sub("1.5", DEVICE.sub("load cell:", made))


@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.__name__.removeprefix("softcal."))
def test_every_sentence_of_the_station_is_said_in_korean(
    module: ModuleType, english_in: Callable[[str], list[str]]
) -> None:
    found = sentences(module)
    assert [(sentence, told(sentence, KOREAN)) for sentence in found if english_in(told(sentence, KOREAN))] == []
    assert [sentence for sentence in found if told(sentence, ENGLISH) != sentence] == []


def test_a_sentence_that_is_in_no_catalogue_would_be_found(english_in: Callable[[str], list[str]]) -> None:
    assert english_in(told("load cell: sings out of tune; check its ears", KOREAN))


@pytest.mark.parametrize("codes", [grbl.ALARMS, grbl.ERRORS, zaber.WARNINGS, gcl2.ERRORS])
def test_every_code_of_a_device_is_explained_in_korean(codes: dict, english_in: Callable[[str], list[str]]) -> None:
    assert [why for why in codes.values() if english_in(told(why, KOREAN))] == []


def test_what_the_self_test_looks_at_has_a_korean_name(english_in: Callable[[str], list[str]]) -> None:
    calls = [node for node in ast.walk(ast.parse(inspect.getsource(self_test))) if isinstance(node, ast.Call)]
    findings = [call for call in calls if isinstance(call.func, ast.Name) and call.func.id == "Finding"]
    names = {arg.value for call in findings for arg in call.args[:2] if isinstance(arg, ast.Constant)}
    assert len(names) > 8
    assert [name for name in names if english_in(told(name, KOREAN))] == []


NOW = datetime(2026, 3, 2, 9, 0, tzinfo=UTC)
GOOD = StationFacts(
    NOW, CellAtGate("K-17", date(2027, 1, 1), 20.0, 0.02), 12.0, NOW, GoldenCheck(NOW, "G1", True),
    RigFacts(timedelta(hours=2), is_homed=True),
)  # fmt: skip
BAD = StationFacts(
    NOW, CellAtGate("K-17", date(2026, 1, 1), 9.0, 0.02), 12.0, NOW, GoldenCheck(NOW, "G1", False),
    RigFacts(homing_fault="stage: homing failed: ALARM:9 (homing switch was not found)", zero_return_N=1.0),
)  # fmt: skip
FAULT = "load cell: reads 3 N unloaded, at most 0.5 N is allowed"
GATES = {
    "good": GOOD,
    "bad": BAD,
    "nothing known": replace(GOOD, certificate=None, golden=None, rig=RigFacts()),
    "zero": replace(GOOD, rig=RigFacts(zero_fault=FAULT)),
}


@pytest.mark.parametrize("facts", GATES.values(), ids=GATES)
def test_every_condition_of_the_gate_is_said_in_korean(
    facts: StationFacts, english_in: Callable[[str], list[str]]
) -> None:
    conditions = may_run(facts, OrderKind.UNIT).conditions
    assert len(conditions) >= 5
    for condition in conditions:
        assert english_in(told(condition.name, KOREAN) + " " + told(condition.says, KOREAN)) == []
        assert told(condition.name, KOREAN) != condition.name


def test_values_and_codes_survive() -> None:
    said = told("stage (/dev/ttyACM0): no answer within 0.5 s; check cable, power and baud rate", KOREAN)
    assert said == "스테이지 (/dev/ttyACM0): 0.5초 안에 응답 없음; 케이블, 전원, 통신 속도를 확인하십시오"


def test_a_cause_within_a_message_is_said_too(english_in: Callable[[str], list[str]]) -> None:
    stopped = f"the station is stopped: {FAULT}; zero it; the stage is stopped and lifted, the run is aborted"
    said = told(f"{stopped}; acknowledge first", KOREAN)
    assert english_in(said) == [] and "무부하 값 3 N" in said and "작업 중단" in said


@pytest.mark.parametrize("language", LANGUAGES)
def test_every_order_and_every_end_of_a_run_has_a_name(language: str) -> None:
    known = catalogue()[language].keys()
    assert {f"order.{kind}" for kind in OrderKind} <= known and {f"run.{state}" for state in RunState} <= known
