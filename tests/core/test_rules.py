"""Rules of other packages: they hold back, whatever was forecast or measured, and are part of what a result is."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint
from itertools import count

import pytest

from softcal.core.errors import InputError
from softcal.core.metrics import rmse
from softcal.core.unit import rules
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.rule_conformance import faults
from softcal.core.unit.rules import Objection, Rule, RuleInput, identity
from softcal.core.unit.unit_problem import UnitProblem
from softcal.core.unit.verdict import Limit

Answer = Callable[[RuleInput], Iterator[Objection]]


@dataclass(frozen=True)
class Answering:
    """A rule that answers as it is told."""

    answer: Answer
    name: str = "house"
    version: str = "1"

    def look(self, rule_input: RuleInput) -> Iterator[Objection]:
        return self.answer(rule_input)


def objecting(press_again: bool = False) -> Answering:
    return Answering(lambda rule_input: iter([Objection("its label is missing: glue one on", press_again)]))


@pytest.fixture
def rule_in_force(monkeypatch: pytest.MonkeyPatch) -> Callable[[Rule], None]:
    def install(rule: Rule) -> None:
        monkeypatch.setattr(rules, "RULES", {identity(rule): rule})

    return install


@pytest.fixture(scope="module")
def unit(press):
    return press(2, gain=1.3, offset_V=0.05, seconds=60.0)


def problem(source_model, unit, **rule_input: object) -> UnitProblem:
    return UnitProblem(source_model, unit.unlabelled, Limit("N", 2.0), **rule_input)


def test_a_rule_holds_a_unit_back_whatever_was_forecast_or_measured(source_model, unit, rule_in_force) -> None:
    assert calibrate(problem(source_model, unit)).decision.verdict == "conditional"
    assert calibrate(problem(source_model, unit, audit=unit)).decision.verdict == "pass"
    rule_in_force(objecting())
    for audit in (None, unit):
        calibration = calibrate(problem(source_model, unit, audit=audit))
        assert calibration.decision.verdict == "fail"
        assert calibration.decision.predicted.verdict == "fail", "a release by sample would let it through"
        (reason_held,) = [one for one in calibration.decision.reasons if one.code == "rule.held"]
        assert reason_held.values["rule"] == "house 1" and "its label is missing: glue one on" in str(reason_held)


def test_a_rule_may_ask_for_another_recording(source_model, unit, rule_in_force) -> None:
    rule_in_force(objecting(press_again=True))
    assert calibrate(problem(source_model, unit, audit=unit)).decision.verdict == "retest"


def test_a_rule_sees_the_unit_and_no_reference_of_it(source_model, unit, rule_in_force) -> None:
    inputs: list[RuleInput] = []
    rule_in_force(Answering(lambda rule_input: iter(inputs.append(rule_input) or [])))
    calibration = calibrate(problem(source_model, unit, audit=unit))
    (rule_input,) = inputs
    assert calibration.decision.verdict == "pass"
    assert rule_input.recording is unit.unlabelled and rule_input.source is source_model.source
    assert rule_input.limit.maximum_rmse == 2.0 and rule_input.measured_rmse == pytest.approx(
        calibration.scores.after.rmse, rel=0.1
    )
    assert rmse(rule_input.estimate, unit.window_reference) == pytest.approx(calibration.scores.after.rmse, rel=0.1)
    assert not any(isinstance(value, type(unit)) and value is unit for value in vars(rule_input).values())


def test_a_rule_that_breaks_lets_nothing_pass_and_stops_no_lot(source_model, unit, rule_in_force) -> None:
    def broken(rule_input: RuleInput) -> Iterator[Objection]:
        raise KeyError("gauge")

    rule_in_force(Answering(broken))
    calibration = calibrate(problem(source_model, unit, audit=unit))
    assert calibration.decision.verdict == "retest"
    broken_by = calibration.decision.reasons[0]
    assert (broken_by.code, broken_by.values["rule"]) == ("rule.broken", "house 1")
    assert "KeyError: 'gauge'" in str(broken_by)


def test_the_rules_are_part_of_what_a_calibration_is(source_model, unit, rule_in_force) -> None:
    without = problem(source_model, unit).input_sha256
    rule_in_force(objecting())
    first = problem(source_model, unit).input_sha256
    rule_in_force(replace(objecting(), version="2"))
    assert len({without, first, problem(source_model, unit).input_sha256}) == 3


def test_a_machine_without_the_rule_decides_nothing(source_model, unit) -> None:
    with pytest.raises(InputError, match="house 1.*U1"):
        calibrate(problem(source_model, unit, rules=("house 1",)))


@pytest.mark.parametrize("value", ["math:pi", "softcal.core.unit.rules:Rule", "softcal.nowhere:x"])
def test_what_is_no_rule_is_refused_with_the_name_of_its_entry_point(value: str) -> None:
    with pytest.raises(InputError, match="'mine'"):
        rules.PLUGINS.merge_plugins({}, [EntryPoint("mine", value, rules.PLUGINS.group)])


COUNT = count()


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        (object(), "`name`"),
        (replace(objecting(), version=" "), "`version`"),
        (Answering(lambda rule_input: iter(["no"])), ""),  # type: ignore[list-item]
        (Answering(lambda rule_input: iter([Objection(str(next(COUNT)))])), ""),
        (Answering(lambda rule_input: iter([Objection("x")] if rule_input.estimate.fill(0) else [])), ""),
        (Answering(lambda rule_input: iter([Objection("x")] if rule_input.measured_rmse > 1 else [])), "TypeError"),  # type: ignore[operator]
    ],
)
def test_the_kit_finds_what_a_rule_does_wrong(rule: Rule, message: str) -> None:
    assert any(message in fault for fault in faults(rule))
    assert faults(objecting()) == []
