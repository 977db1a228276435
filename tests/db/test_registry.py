"""The registry keeps what it was given, names what it does not have, and never forgets a revision."""

from datetime import UTC, datetime

import numpy as np
import pytest

from softcal.core.errors import InputError
from softcal.core.lot import Lot, UnitKey, row_name
from softcal.core.messages.reason import plain, reason
from softcal.core.recording import OutputRecording
from softcal.core.unit.state_json import adjustments_to_json, fit_to_json
from softcal.db.connection import open_registry
from softcal.db.repositories.registry_base import RegistrySettings

A1 = UnitKey("L1", "A1")


def test_a_lot_comes_back_as_it_was_given(registry):
    lot = Lot("L 1", "S0", 50.0, "nylon", "force", "N", "ohm", 0.25)
    registry.lots.add(lot)
    assert registry.lots.all() == [lot] and registry.lots.get("L 1") == lot


def test_serials_of_any_script_and_rows_of_names_that_are_none_come_back(factory, recording_of):
    registry, serials = factory.registry, ["센서-001", "Gerät_7", "датчик.3", "가" * 64]
    for serial in serials:
        sha256 = registry.recordings.add("L1", recording_of(serial), "unit")
        assert registry.recordings.get(sha256).serial == serial
    rows = [row_name(name) for name in ("bad name!", "a\u202eb", "x" * 90, "\udcff")]
    for row in rows:
        registry.calibrations.refuse("L1", row, "retest", (reason("name.serial", serial=repr(row)),))
    listed = {unit.serial: unit for unit in registry.lots.units("L1")}
    assert {*serials, *rows} <= listed.keys()
    assert all(listed[row].verdict == "retest" and listed[row].reasons[0].code == "name.serial" for row in rows)


def test_the_same_lot_again_changes_nothing(factory):
    before = len(factory.registry.trail.rows())
    factory.registry.lots.add(factory.registry.lots.get("L1"))
    assert len(factory.registry.trail.rows()) == before


def test_a_lot_with_another_source_is_refused(factory):
    with pytest.raises(InputError, match="'S0'.*'S9'"):
        factory.registry.lots.add(Lot("L1", "S9", 50.0))


def test_another_limit_makes_a_new_version(factory):
    factory.registry.lots.add(Lot("L1", "S0", 50.0, limit_rmse=0.3))
    assert [entry.rmse for entry in factory.registry.lots.limit_versions("L1")] == [2.0, 0.3]


def test_a_limit_set_in_the_registry_stays_until_the_lot_states_another(factory):
    factory.registry.lots.set_limit("L1", 0.1, reason="drawing C")
    factory.registry.lots.add(Lot("L1", "S0", 50.0, limit_rmse=2.0))
    assert factory.registry.lots.get("L1").limit_rmse == 0.1
    factory.registry.lots.add(Lot("L1", "S0", 50.0, limit_rmse=0.3))
    assert factory.registry.lots.get("L1").limit_rmse == 0.3


def test_a_limit_changed_by_somebody_else_is_not_overwritten(factory):
    version = factory.registry.lots.limit("L1").version
    factory.registry.lots.set_limit("L1", 0.4, reason="new customer", actor="kim", expected_version=version)
    with pytest.raises(InputError, match="0.4.*kim"):
        factory.registry.lots.set_limit("L1", 0.5, reason="old screen", expected_version=version)
    assert factory.registry.lots.limit("L1").rmse == 0.4


def test_recordings_come_back_with_every_bit(factory, recording_of, labelled_of):
    plain, labelled = recording_of("A1"), labelled_of("A1")
    staged = OutputRecording("A2", plain.t_s, plain.output, 50.0, "V", np.arange(60.0))
    for recording, kind in ((plain, "unit"), (labelled, "audit"), (staged, "unit")):
        sha256 = factory.registry.recordings.add("L1", recording, kind)
        back = factory.registry.recordings.get(sha256)
        assert type(back) is type(recording) and back.settings() == recording.settings()
        assert all(np.array_equal(back.arrays()[name], array) for name, array in recording.arrays().items())


def test_a_recording_is_stored_once(factory, recording_of):
    first = factory.registry.recordings.add("L1", recording_of("A1"), "unit")
    assert factory.registry.recordings.add("L1", recording_of("A1"), "unit") == first
    assert [entry.sha256 for entry in factory.registry.recordings.of_lot("L1", "A1")] == [first]


def test_a_network_comes_back_under_its_content_hash(factory, network):
    back = factory.registry.networks.get(factory.network_id)
    assert back.id == network.id == factory.registry.networks.find("a" * 64)
    assert factory.registry.networks.entry(network.id).metrics == {"rmse": 0.05}


def test_the_first_of_two_networks_of_one_input_is_kept(factory, network):
    other = type(network)(network.weights, network.biases, 0.6, 0.1, 1.0, 2.0)
    assert factory.registry.networks.add("L1", other, {}, {}, "a" * 64) == network.id
    assert factory.registry.networks.find("b" * 64) is None


def test_a_calibration_comes_back_as_it_was_given(factory):
    state = factory.state("A1")
    revision = factory.registry.calibrations.add("L1", state, actor="kim", reason="first")
    stored = factory.registry.calibrations.get("A1")
    assert (revision, stored.revision, stored.actor, stored.reason) == (1, 1, "kim", "first")
    fit_before, back = (fit_to_json(one.fit) for one in (state, stored.state))
    assert back.content == fit_before.content and adjustments_to_json(stored.state) == adjustments_to_json(state)
    arrays, stored_arrays = fit_before.arrays, back.arrays
    assert all(np.array_equal(stored_arrays[name], array) for name, array in arrays.items())
    assert stored.state.decision == state.decision and stored.state.map_sha256 == state.map_sha256


def test_revisions_count_per_serial_and_the_newest_is_in_use(factory):
    assert [factory.calibrate("A1", 1), factory.calibrate("A1", 2), factory.calibrate("B1", 1)] == [1, 2, 1]
    assert [(c.revision, c.is_current) for c in factory.registry.calibrations.history("A1")] == [(1, False), (2, True)]


def test_a_rollback_is_a_new_revision_that_repeats_the_old_one(factory):
    factory.calibrate("A1", 1)
    factory.calibrate("A1", 2)
    assert factory.registry.calibrations.rollback("A1", 1, reason="remounted", actor="lee") == 3
    current = factory.registry.calibrations.get("A1")
    assert (current.revision, current.rolled_back_to, current.reason, current.actor) == (3, 1, "remounted", "lee")
    assert current.state.map_sha256 == factory.registry.calibrations.get("A1", 1).state.map_sha256


@pytest.mark.parametrize(("to", "reason"), [(1, " "), (2, "x"), (7, "x")])
def test_a_senseless_rollback_changes_nothing(factory, to, reason):
    factory.calibrate("A1", 1)
    factory.calibrate("A1", 2)
    with pytest.raises(InputError):
        factory.registry.calibrations.rollback("A1", to, reason=reason)
    assert len(factory.registry.calibrations.history("A1")) == 2


def test_finished_work_is_found_by_its_input(factory):
    factory.calibrate("A1", 1)
    fit_id = factory.state("A1", 1).fit.id
    assert factory.registry.calibrations.find("A1", fit_id).revision == 1
    assert factory.registry.calibrations.find("A1", fit_id, lot_id="other") is None
    assert factory.registry.calibrations.find("A1", "f" * 64) is None


def test_units_show_their_newest_result(factory):
    factory.calibrate("A2", 1)
    factory.calibrate("A2", 2)
    factory.registry.calibrations.refuse("L1", "A1", "retest", (plain("t_s goes backward"),))
    units = {unit.serial: unit for unit in factory.registry.lots.units("L1")}
    assert list(units) == ["A1", "A2", "S0"]
    assert (units["A2"].verdict, units["A2"].revision, units["A2"].predicted_rmse) == ("pass", 2, 0.2)
    assert (units["A1"].verdict, units["A1"].reasons) == ("retest", (plain("t_s goes backward"),))
    assert (units["S0"].role, units["S0"].verdict) == ("source", None)


def test_a_refusal_after_a_good_map_shows_but_keeps_the_map(factory):
    factory.calibrate("A1", 1)
    factory.registry.calibrations.refuse("L1", "A1", "fail", (plain("constant output"),))
    (unit,) = factory.registry.lots.units(serial="A1")
    assert (unit.verdict, unit.revision) == ("fail", 1)
    assert factory.registry.calibrations.get("A1").revision == 1


def test_the_same_refusal_is_written_once(factory):
    for _ in range(2):
        factory.registry.calibrations.refuse("L1", "A1", "fail", (plain("constant output"),))
    assert sum(row.action == "refuse" for row in factory.registry.trail.rows()) == 1


@pytest.mark.parametrize(
    "ask",
    [
        lambda r: r.lots.get("nowhere"),
        lambda r: r.lots.units("nowhere"),
        lambda r: r.calibrations.history("nobody"),
        lambda r: r.calibrations.get("nobody"),
        lambda r: r.recordings.get("0" * 64),
        lambda r: r.networks.get("0" * 64),
    ],
)
def test_what_is_not_there_is_named(factory, ask):
    with pytest.raises(InputError, match="nowhere|nobody|000000"):
        ask(factory.registry)


def test_a_serial_that_stands_in_two_lots_is_asked_for_with_its_lot(factory, make_factory):
    factory.calibrate("A1", 1)
    other = make_factory(factory.registry, "L2")
    assert other.calibrate("A1", 2) == 2
    for ask in (
        factory.registry.calibrations.get,
        lambda serial: factory.registry.calibrations.rollback(serial, 1, reason="x"),
    ):
        with pytest.raises(InputError, match="'L1', 'L2'"):
            ask("A1")
    assert [factory.registry.calibrations.get("A1", lot_id=lot).revision for lot in ("L1", "L2")] == [1, 2]
    assert [c.is_current for c in factory.registry.calibrations.history("A1")] == [True, True]
    with pytest.raises(InputError, match="2 .*'L1'"):
        factory.registry.calibrations.rollback("A1", 2, reason="x", lot_id="L1")
    assert [unit.revision for unit in factory.registry.lots.units(serial="A1")] == [1, 2]


def test_what_raises_in_a_transaction_is_gone_whole(factory):
    before = len(factory.registry.trail.rows())
    with pytest.raises(ZeroDivisionError), factory.registry.transaction():
        factory.calibrate("A1", 1)
        raise ZeroDivisionError
    assert len(factory.registry.trail.rows()) == before
    assert [unit.serial for unit in factory.registry.lots.units("L1")] == ["S0"]


def test_a_clock_set_back_does_not_reorder_the_history(registry_url, make_factory):
    times = iter([datetime(2026, 5, 4, tzinfo=UTC)] * 14 + [datetime(2020, 1, 1, tzinfo=UTC)] * 14)
    with open_registry(registry_url, RegistrySettings(clock=lambda: next(times))) as registry:
        factory = make_factory(registry)
        revisions = [factory.calibrate("A1", number) for number in (1, 2, 3)]
        assert registry.calibrations.get("A1").revision == revisions[-1] == 3


def test_every_change_names_who_and_when(factory):
    factory.calibrate("A1", 1)
    calibrated_row, in_use_row = factory.registry.trail.rows()[-2:]
    assert (calibrated_row.actor, calibrated_row.action, calibrated_row.entity) == (
        "tester",
        "calibrate",
        "calibrations",
    )
    assert (in_use_row.actor, in_use_row.action, in_use_row.entity) == ("tester", "put_in_use", "in_use")
    assert calibrated_row.at.tzinfo is not None


def test_an_adaptation_resumes_from_its_last_step(factory):
    factory.calibrate("A1", 1)
    steps = [{"stream": "s", "sample": k, "map": {"gain": 1.0 + k}} for k in (10, 20)]
    assert factory.registry.adaptations.add(A1, 1, steps) == 2
    assert factory.registry.adaptations.add(A1, 1, [{"stream": "t", "sample": 5}]) == 3
    assert factory.registry.adaptations.last(A1, 1, "s") == steps[-1]
    assert factory.registry.adaptations.last(A1, 1, "u") is None
    assert factory.registry.adaptations.all(A1, "s") == steps
    with pytest.raises(InputError, match=r"\b2\b"):
        factory.registry.adaptations.add(A1, 2, steps[:1])


def test_a_lot_read_from_the_registry_states_no_new_limit(factory):
    factory.registry.lots.set_limit("L1", 0.1, reason="drawing C")
    factory.registry.lots.add(factory.registry.lots.get("L1"))
    assert [entry.rmse for entry in factory.registry.lots.limit_versions("L1")] == [2.0, 0.1]
