"""A station that was offline and the line's registry end up with the same history, whatever happens on the way."""

from datetime import UTC, datetime, timedelta

import pytest
from sqlalchemy import text

from softcal.core.errors import InputError, RegistryError
from softcal.core.lot import Lot
from softcal.db import sync
from softcal.db.backup import back_up, restore
from softcal.db.connection import open_registry
from softcal.db.registry_base import RegistrySettings
from softcal.db.sync import synchronise


@pytest.fixture
def station(file_registry, make_factory, recording_of):
    factory = make_factory(file_registry)
    for serial in ("A1", "A2"):
        file_registry.add_recording("L1", recording_of(serial), "unit")
        factory.calibrate(serial, 1)
    return factory


def same_history(here, there) -> bool:
    return here.audit_rows() == there.audit_rows() and here.units() == there.units()


def test_a_new_central_registry_gets_everything(station, registry):
    report = synchronise(station.registry, registry)
    assert report.sent == len(station.registry.audit_rows()) and report.received == 0 and report.conflicts == ()
    assert same_history(station.registry, registry) and registry.verify() == []
    assert registry.recording(station.record("A1").recording_sha256).serial == "A1"
    assert registry.network(station.network_id).id == station.network_id


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
    assert (report.sent, report.received, report.conflicts) == (1, 1, ())
    assert same_history(station.registry, registry)
    assert station.registry.calibration("A1").revision == registry.calibration("A2").revision == 2
    assert registry.verify() == station.registry.verify() == []


def test_two_results_for_one_serial_are_both_kept_and_the_newest_counts(station, registry, make_factory):
    synchronise(station.registry, registry)
    station.calibrate("A1", 2)
    make_factory(registry).calibrate("A1", 3)
    report = synchronise(station.registry, registry)
    assert len(report.conflicts) == 1 and "A1 revision 2 was calibrated by two registries" in report.conflicts[0]
    for side in (station.registry, registry):
        assert [(c.revision, c.is_conflict) for c in side.history("A1")] == [(1, False), (2, True), (2, True)]
        assert side.calibration("A1").record.predicted_rmse == pytest.approx(0.3)
        assert next(unit for unit in side.units() if unit.serial == "A1").is_conflict
        assert side.verify() == []
    assert station.calibrate("A1", 4) == 3


def test_the_same_lot_registered_on_both_sides_comes_together(station, registry, make_factory):
    make_factory(registry)
    assert synchronise(station.registry, registry).conflicts == (
        "lot 'L1' limit version 1 was set by two registries; the newer one holds",
    )
    assert registry.verify() == station.registry.verify() == []


def test_a_lot_with_other_facts_elsewhere_is_told(station, registry):
    registry.add_lot(Lot("L1", "S9", 100.0))
    report = synchronise(station.registry, registry)
    assert any("'L1' was registered with other facts" in line for line in report.conflicts)
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
    came_over = len(registry.audit_rows())
    assert 0 < came_over < len(station.registry.audit_rows())
    monkeypatch.setattr(sync, "_copy", copy)
    assert synchronise(station.registry, registry).sent == len(station.registry.audit_rows()) - came_over
    assert same_history(station.registry, registry) and registry.verify() == []


def test_a_third_station_learns_of_the_first_through_the_centre(station, registry, tmp_path, make_factory):
    synchronise(station.registry, registry)
    make_factory(registry).calibrate("A3", 1)
    with open_registry(f"sqlite:///{tmp_path / 'second.db'}") as second:
        synchronise(second, registry)
        assert [unit.serial for unit in second.units()] == ["A1", "A2", "A3", "S0"]
        assert second.verify() == [] and same_history(second, registry)


def test_a_damaged_chain_is_not_passed_on(station, registry):
    with station.registry.database.writing() as connection:
        connection.execute(text("DROP TRIGGER audit_no_update"))
        connection.execute(text("UPDATE audit SET actor = 'x' WHERE seq = 3"))
    with pytest.raises(RegistryError, match="row 3 is damaged"):
        synchronise(station.registry, registry)
    assert registry.audit_rows() == []


def test_a_registry_is_not_synchronised_with_a_copy_of_itself(station, tmp_path):
    back_up(station.registry.database, tmp_path / "copy.db")
    with open_registry(f"sqlite:///{tmp_path / 'copy.db'}") as copy, pytest.raises(InputError, match="plain copy"):
        synchronise(station.registry, copy)


def test_a_restored_copy_may_go_on_beside_the_old_one(station, registry, tmp_path):
    back_up(station.registry.database, tmp_path / "backup.db")
    restore(tmp_path / "backup.db", f"sqlite:///{tmp_path / 'second.db'}")
    later = datetime.now(UTC) + timedelta(hours=1)
    with open_registry(f"sqlite:///{tmp_path / 'second.db'}", RegistrySettings(clock=lambda: later)) as second:
        second.add_calibration("L1", station.record("A1", 5))
        station.calibrate("A1", 6)
        synchronise(second, registry)
        report = synchronise(station.registry, registry)
        assert "A1 revision 2" in report.conflicts[0]
        assert registry.calibration("A1").record.predicted_rmse == pytest.approx(0.5), "the newest counts"
        assert registry.verify() == []
