"""The rules of a lot come in versions with their reasons."""

import pytest

from softcal.core.errors import InputError
from softcal.core.lot import Lot
from softcal.core.messages.reason import plain
from softcal.core.quality.known_loads import KnownLoad
from softcal.core.quality.line_rules import LineRules

LOT = Lot("L1", "A0", 50.0)


@pytest.fixture
def lot(registry) -> Lot:
    registry.lots.add(LOT)
    return LOT


def test_a_lot_without_rules_spells_its_serials_as_its_source(registry, lot):
    assert registry.lots.line_rules(lot).spell("a7") == "A7"


def test_rules_are_versions_with_a_reason_in_the_audit_trail(registry, lot):
    registry.lots.set_line_rules("L1", LineRules(target=6), reason="first order", actor="kim")
    loads = (KnownLoad(0.0), KnownLoad(2.0, 0.002))
    rules = LineRules(r"A\d+", "upper", 12, {"fail": 0}, loads, is_badge_needed=True)
    registry.lots.set_line_rules("L1", rules, reason="order doubled", actor="lee", expected_version=1)
    assert registry.lots.line_rules(lot) == rules
    assert [(e.version, e.actor, e.reason) for e in registry.lots.line_rules_versions("L1")] == [
        (1, "kim", "first order"),
        (2, "lee", "order doubled"),
    ]
    assert registry.trail.rows()[-1].reason == "order doubled" and registry.verify() == []


def test_two_editors_of_rules_do_not_overwrite_each_other(registry, lot):
    registry.lots.set_line_rules("L1", LineRules(target=6), reason="first order", actor="kim")
    with pytest.raises(InputError, match="kim"):
        registry.lots.set_line_rules("L1", LineRules(target=7), reason="mine", expected_version=0)


def test_rules_need_a_reason(registry, lot):
    with pytest.raises(InputError):
        registry.lots.set_line_rules("L1", LineRules(), reason=" ")


@pytest.mark.parametrize(
    "fields",
    [{"serial_pattern": "A["}, {"letters": "capital"}, {"target": 0}, {"retests": {"fail": -1}}, {"retests": {"x": 1}}],
)
def test_senseless_rules_are_refused(fields):
    with pytest.raises(InputError):
        LineRules(**fields)


def test_the_results_of_one_unit_are_read_alone(registry, lot):
    for serial, verdict in (("A1", "retest"), ("A2", "fail"), ("A1", "fail")):
        registry.calibrations.refuse("L1", serial, verdict, (plain(f"{serial} {verdict}"),))
    assert [run.verdict for run in registry.lots.runs("L1", "A1")] == ["retest", "fail"]


def test_rules_and_a_limit_that_are_set_again_for_the_same_reason_are_one_version(registry, lot):
    for _ in range(2):
        registry.lots.set_line_rules("L1", LineRules(target=6), reason="first order", actor="kim")
        registry.lots.set_limit("L1", 0.1, reason="drawing C", actor="kim", expected_version=0)
    assert len(registry.lots.line_rules_versions("L1")) == 1 and registry.lots.limit("L1").version == 1
    registry.lots.set_limit("L1", 0.1, reason="drawing D", actor="kim")
    assert registry.lots.limit("L1").version == 2
