"""A station that was offline and the line's registry end up with the same history, whatever happens on the way."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from sqlalchemy import text

from softcal.core.errors import InputError, RegistryError
from softcal.core.lot import Lot
from softcal.core.messages.reason import plain
from softcal.db.connection import open_registry
from softcal.db.maintenance import sync
from softcal.db.maintenance.backup import back_up, restore
from softcal.db.maintenance.sync import synchronise
from softcal.db.repositories.lot_pages import UnitFilter
from softcal.db.repositories.registry_base import RegistrySettings


@pytest.fixture
def station(file_registry, make_factory, recording_of):
    factory = make_factory(file_registry)
    for serial in ("A1", "A2"):
        file_registry.recordings.add("L1", recording_of(serial), "unit")
        factory.calibrate(serial, 1)
    return factory


def same_history(here, there) -> bool:
    return here.trail.rows() == there.trail.rows() and here.lots.units() == there.lots.units()


def test_a_new_central_registry_gets_everything(station, registry):
    report = synchronise(station.registry, registry)
    assert report.sent == len(station.registry.trail.rows()) and report.received == 0 and report.conflicts == ()
    assert same_history(station.registry, registry) and registry.verify() == []
    assert registry.recordings.get(station.state("A1").fit.recording_sha256).serial == "A1"
    assert registry.networks.get(station.network_id).id == station.network_id


def test_sending_twice_changes_nothing(station, registry):
    synchronise(station.registry, registry)
    again = synchronise(station.registry, registry)
    assert (again.sent, again.received) == (0, 0)


def test_both_sides_get_what_the_other_did(station, registry, make_factory):
    synchronise(station.registry, registry)
    central = make_factory(registry)
    central.calibrate("A1", 2)
    station.calibrate("A2", 3)
    report = synchronise(station.registry, registry)
    # A fit, an audit, a revision and a statement of use.
    assert (report.sent, report.received, report.conflicts) == (4, 4, ())
    assert same_history(station.registry, registry)
    assert station.registry.calibrations.get("A1").revision == registry.calibrations.get("A2").revision == 2
    assert registry.verify() == station.registry.verify() == []


def test_of_two_results_for_one_serial_a_person_decides(station, registry, make_factory):
    synchronise(station.registry, registry)
    station.calibrate("A1", 2)
    make_factory(registry).calibrate("A1", 3)
    mine, yours = station.registry.origin, registry.origin
    report = synchronise(station.registry, registry)
    assert len(report.conflicts) == 1 and mine in report.conflicts[0] and yours in report.conflicts[0]
    for side in (station.registry, registry):
        assert [(c.revision, c.is_conflict) for c in side.calibrations.history("A1")] == [
            (1, False),
            (2, True),
            (2, True),
        ]
        with pytest.raises(InputError, match=f"{mine}.*{yours}|{yours}.*{mine}"):
            side.calibrations.get("A1")
        (unit,) = side.lots.units(serial="A1")
        page = side.pages.unit_page("L1", UnitFilter(text="A1")).units[0]
        assert unit == page and unit.is_conflict and (unit.verdict, unit.revision) == ("retest", None)
        assert side.pages.verdict_counts("L1")["retest"] == 1
        assert side.verify() == []
        with pytest.raises(InputError):
            side.calibrations.rollback("A1", 2, reason="which?")
    assert registry.calibrations.rollback("A1", 2, origin=mine, reason="the other was not seated") == 3
    assert synchronise(station.registry, registry).conflicts == ()
    for side in (station.registry, registry):
        assert side.calibrations.get("A1").state.predicted_rmse == pytest.approx(0.2)
        assert side.calibrations.get("A1", 2, origin=yours).state.predicted_rmse == pytest.approx(0.3)
        assert side.verify() == []
    assert station.calibrate("A1", 4) == 4


def test_a_refusal_after_a_conflict_is_what_every_question_tells(station, registry, make_factory):
    synchronise(station.registry, registry)
    station.calibrate("A1", 2)
    make_factory(registry).calibrate("A1", 3)
    synchronise(station.registry, registry)
    registry.calibrations.refuse("L1", "A1", "fail", (plain("cable"),))
    (unit,) = registry.lots.units(serial="A1")
    (paged,) = registry.pages.unit_page("L1", UnitFilter(text="A1")).units
    status = registry.pages.unit_statuses("L1", ["A1"])["A1"]
    assert unit == paged and unit.is_conflict
    for answer in (unit, status, registry.lots.runs("L1", "A1")[-1]):
        assert (answer.verdict, answer.reasons) == ("fail", (plain("cable"),))
    assert status.calibration is None and registry.pages.verdict_counts("L1")["fail"] == 1


def test_the_same_map_made_twice_is_no_conflict(station, registry, make_factory):
    synchronise(station.registry, registry)
    station.calibrate("A1", 2)
    make_factory(registry).calibrate("A1", 2)
    assert synchronise(station.registry, registry).conflicts == ()
    assert registry.calibrations.get("A1").state.map_sha256 == station.registry.calibrations.get("A1").state.map_sha256


def test_two_decisions_on_a_lot_of_one_number_are_a_conflict_that_the_next_one_ends(station, registry):
    synchronise(station.registry, registry)
    for side, released in ((station.registry, ["A1"]), (registry, ["A2"])):
        assert side.decisions.add("L1", {"released": released}, action="release") == 1
    report = synchronise(station.registry, registry)
    (line,) = report.conflicts
    assert all(part in line for part in ("L1", "decision 1", station.registry.origin, registry.origin))
    for side in (station.registry, registry):
        assert side.decisions.in_force("L1").decision == {"released": ["A2"]}, "the one that was made last"
    assert station.registry.decisions.add("L1", {"released": ["A1", "A2"]}, action="release") == 2
    assert synchronise(station.registry, registry).conflicts == ()
    assert registry.decisions.in_force("L1").number == 2


def test_two_persons_who_decide_differently_are_a_conflict_again(station, registry, make_factory):
    synchronise(station.registry, registry)
    station.calibrate("A1", 2)
    make_factory(registry).calibrate("A1", 3)
    synchronise(station.registry, registry)
    mine, yours = station.registry.origin, registry.origin
    station.registry.calibrations.rollback("A1", 2, origin=mine, reason="mine")
    registry.calibrations.rollback("A1", 2, origin=yours, reason="yours")
    assert len(synchronise(station.registry, registry).conflicts) == 1
    station.calibrate("A1", 5)
    assert synchronise(station.registry, registry).conflicts == (), "a calibration of today follows both"


def test_a_clock_that_is_ahead_is_reported_and_does_not_win(station, registry, make_factory):
    synchronise(station.registry, registry)
    ahead = datetime.now(UTC) + timedelta(days=30)
    station.registry.calibrations.settings = RegistrySettings(clock=lambda: ahead)
    station.calibrate("A1", 2)
    make_factory(registry).calibrate("A1", 3)
    report = synchronise(registry, station.registry)
    assert any(station.registry.origin in line and "29 days" in line for line in report.clocks)
    with pytest.raises(InputError, match=registry.origin):
        registry.calibrations.get("A1")


def test_the_same_lot_registered_on_both_sides_comes_together(station, registry, make_factory):
    make_factory(registry)
    assert synchronise(station.registry, registry).conflicts == ()
    assert registry.verify() == station.registry.verify() == []


def test_another_limit_or_other_rules_of_one_version_are_a_conflict(station, registry, make_factory):
    make_factory(registry)
    for side, number in ((station.registry, 1), (registry, 2)):
        side.lots.set_limit("L1", 0.1 * number, reason="test")
        lot = side.lots.get("L1")
        side.lots.set_line_rules("L1", replace(side.lots.line_rules(lot), target=number), reason="test")
    conflicts = synchronise(station.registry, registry).conflicts
    assert len(conflicts) == 2 and all("'L1'" in line for line in conflicts)
    station.registry.lots.set_limit("L1", 0.3, reason="test")
    (conflict,) = synchronise(station.registry, registry).conflicts
    assert "rules" in conflict


def test_a_lot_with_other_data_elsewhere_is_reported(station, registry):
    registry.lots.add(Lot("L1", "S9", 100.0))
    report = synchronise(station.registry, registry)
    assert any("'L1'" in line for line in report.conflicts)
    assert registry.verify() == station.registry.verify() == []


def test_a_line_that_breaks_loses_nothing_and_goes_on_where_it_was(station, registry, monkeypatch):
    monkeypatch.setattr(sync, "ROWS_AT_ONCE", 3)
    copy, calls = sync._copy, []

    def breaking(*arguments):
        calls.append(1)
        if len(calls) > 5:
            raise RegistryError("the connection broke")
        copy(*arguments)

    monkeypatch.setattr(sync, "_copy", breaking)
    with pytest.raises(RegistryError, match="broke"):
        synchronise(station.registry, registry)
    came_over = len(registry.trail.rows())
    assert 0 < came_over < len(station.registry.trail.rows())
    monkeypatch.setattr(sync, "_copy", copy)
    assert synchronise(station.registry, registry).sent == len(station.registry.trail.rows()) - came_over
    assert same_history(station.registry, registry) and registry.verify() == []


def test_a_third_station_learns_of_the_first_through_the_centre(station, registry, tmp_path, make_factory):
    synchronise(station.registry, registry)
    make_factory(registry).calibrate("A3", 1)
    with open_registry(f"sqlite:///{tmp_path / 'second.db'}") as second:
        synchronise(second, registry)
        assert [unit.serial for unit in second.lots.units()] == ["A1", "A2", "A3", "S0"]
        assert second.verify() == [] and same_history(second, registry)


def test_a_damaged_chain_is_not_passed_on(station, registry):
    with station.registry.database.writing() as connection:
        connection.execute(text("DROP TRIGGER audit_no_update"))
        connection.execute(text("UPDATE audit SET actor = 'x' WHERE seq = 3"))
    with pytest.raises(RegistryError, match="row 3"):
        synchronise(station.registry, registry)
    assert registry.trail.rows() == []


def test_a_registry_is_not_synchronised_with_a_copy_of_itself(station, tmp_path):
    back_up(station.registry.database, tmp_path / "copy.db")
    with open_registry(f"sqlite:///{tmp_path / 'copy.db'}") as copy, pytest.raises(InputError):
        synchronise(station.registry, copy)


@pytest.mark.long
def test_a_restored_copy_may_go_on_beside_the_old_one(station, registry, tmp_path):
    back_up(station.registry.database, tmp_path / "backup.db")
    restore(tmp_path / "backup.db", f"sqlite:///{tmp_path / 'second.db'}")
    later = datetime.now(UTC) + timedelta(hours=1)
    with open_registry(f"sqlite:///{tmp_path / 'second.db'}", RegistrySettings(clock=lambda: later)) as second:
        second.calibrations.add("L1", station.state("A1", 5))
        station.calibrate("A1", 6)
        synchronise(second, registry)
        report = synchronise(station.registry, registry)
        assert "A1" in report.conflicts[0]
        registry.calibrations.rollback("A1", 2, origin=second.origin, reason="the second one is mounted")
        assert registry.calibrations.get("A1").state.predicted_rmse == pytest.approx(0.5)
        assert registry.verify() == []
