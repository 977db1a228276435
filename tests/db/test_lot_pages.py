"""A lot in pages says the same as the lot as a whole, whatever was calibrated again, refused or not begun."""

from dataclasses import replace
from datetime import UTC, datetime

import pytest

from softcal.core.errors import InputError
from softcal.core.messages.reason import plain
from softcal.core.quality.line_rules import LineRules
from softcal.core.unit.measured_error import MeasuredError, OwnCalibrationScores, Scores
from softcal.db.entries import GoldenRun
from softcal.db.repositories.lot_pages import UnitFilter
from tests.unit_states import ROWS


@pytest.fixture
def lot(factory, recording_of):
    """Ten units: calibrated once, twice, refused before and after a map, refused only, and not begun."""
    registry = factory.registry
    for k in range(6):
        verdict = ("pass", "fail", "conditional")[k % 3]
        registry.calibrations.add("L1", factory.state(f"A{k}", k + 1, verdict))
    measured = factory.state("A1", 9)
    scores = Scores(
        MeasuredError(0.9, ROWS), MeasuredError(0.4, ROWS), OwnCalibrationScores(*[MeasuredError(0.3, 900)] * 3)
    )
    registry.calibrations.add("L1", replace(measured, audit=replace(measured.audit, scores=scores)))
    registry.calibrations.refuse("L1", "A2", "retest", (plain("cable"),))
    registry.calibrations.refuse("L1", "B1", "fail", (plain("dead"),))
    registry.calibrations.refuse("L1", "B2", "retest", (plain("noise"),))
    registry.calibrations.add("L1", factory.state("B2", 2))
    registry.recordings.add("L1", recording_of("C%1"), "unit")
    return registry


def test_the_pages_together_are_the_lot(lot):
    pages = [lot.pages.unit_page("L1", UnitFilter(), size=4, before=before) for before in (0, 4, 8)]
    assert [page.total for page in pages] == [9, 9, 9]
    expected = [unit for unit in lot.lots.units("L1") if unit.role == "target"]
    assert [unit for page in pages for unit in page.units] == expected


def test_the_counts_are_those_of_the_units(lot):
    assert lot.pages.verdict_counts("L1") == {"fail": 2, "retest": 1, "conditional": 1, "pass": 4, "none": 1}


def test_a_filter_takes_verdicts_and_text_as_it_is_written(lot):
    def serials(**lot_filter):
        return [unit.serial for unit in lot.pages.unit_page("L1", UnitFilter(**lot_filter)).units]

    assert serials(verdicts=("none",)) == ["C%1"] and serials(text="%") == ["C%1"]
    assert serials(text="b", verdicts=("pass", "fail")) == ["B1", "B2"]


def test_the_worst_come_first_and_units_without_a_value_last(lot):
    worst = [unit.verdict for unit in lot.pages.unit_page("L1", UnitFilter(sort="severity")).units]
    assert worst == ["retest", "fail", "fail", "conditional", "pass", "pass", "pass", "pass", None]
    by_error = lot.pages.unit_page("L1", UnitFilter(sort="predicted_rmse", is_descending=True)).units
    errors = [unit.predicted_rmse for unit in by_error]
    assert errors[:7] == sorted(errors[:7], reverse=True) and errors[7:] == [None, None]


def test_the_errors_are_those_of_the_newest_maps(lot):
    rows = {row.serial: row for row in lot.pages.lot_errors("L1")}
    assert (rows["A1"].verdict, rows["A1"].errors) == ("pass", (0.9, 0.9, 0.4, 0.3))
    assert rows["A2"].verdict == "retest" and "B1" not in rows


def test_the_marker_changes_with_whatever_is_added_to_a_lot(lot, factory, recording_of):
    golden = GoldenRun("line-1", "L1", "G1", datetime.now(UTC), 0.1, "N", True, (), "Oh")
    changes = (
        lambda: factory.calibrate("A1", 12),
        lambda: lot.calibrations.refuse("L1", "A1", "retest", (plain("dead"),)),
        lambda: lot.recordings.add("L1", recording_of("A77"), "unit"),
        lambda: lot.lots.set_limit("L1", 0.3, reason="drawing"),
        lambda: lot.lots.set_line_rules("L1", LineRules(target=9), reason="order"),
        lambda: lot.stations.add_golden_run(golden),
    )
    for change in changes:
        before = lot.pages.change_marker("L1")
        assert lot.pages.change_marker("L1") == before
        change()
        assert lot.pages.change_marker("L1") != before


def test_an_unknown_order_or_lot_is_named(lot):
    with pytest.raises(InputError, match="'rmse; drop'"):
        UnitFilter(sort="rmse; drop")
    with pytest.raises(InputError, match="'L9'"):
        lot.pages.unit_page("L9", UnitFilter())
