"""Histories of a lot by all acts, at two stations with a sync: what is released passes on every surface, an act changes
what its preview named, and the order of independent acts changes nothing. Fits are given, everything else is real."""

import itertools
import shutil
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import pytest

from softcal.app.calibration.lot_context import store_result
from softcal.app.calibration.lot_decision import decision_in_force
from softcal.app.calibration.release import decide_lot, read_lot_status, roll_back
from softcal.core.quality.lot_status import Disposition
from softcal.db.connection import open_registry
from softcal.db.registry import Registry
from softcal.db.repositories.registry_base import RegistrySettings
from tests.unit_histories import (
    LOT,
    START,
    bring_audit,
    calibrated,
    check_surfaces,
    make_registries,
    run_histories,
    trim_unit,
)


@pytest.fixture(scope="session")
def two_registries(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the registries of both sides."""
    folder = tmp_path_factory.mktemp("histories")
    make_registries(folder)
    return folder


@pytest.fixture
def registry(two_registries: Path, tmp_path: Path) -> Iterator[Registry]:
    """The registry of one side, after its release."""
    shutil.copy(two_registries / "station.db", tmp_path)
    ticks = itertools.count(86_400)
    clock = RegistrySettings(clock=lambda: START + timedelta(seconds=next(ticks)))
    with open_registry(f"sqlite:///{tmp_path / 'station.db'}", clock) as registry:
        yield registry


def test_an_audit_decided_on_by_another_limit_qualifies_nothing_before_its_unit_is_decided_again(registry):
    audited = [unit.serial for unit in read_lot_status(registry, LOT.id).on(Disposition.MEASURED)]
    registry.lots.set_limit(LOT.id, 0.4, reason="drawing D")
    roll_back(registry, audited[0], 1, reason="drawn", lot_id=LOT.id)
    status = read_lot_status(registry, LOT.id)
    assert {unit.serial for unit in status.units if unit.is_measured} == set(audited[:1])
    assert {one.serial for one in status.decided.qualification.lot_audits} <= set(audited[:1])


def test_a_statement_made_again_counts_the_units_that_it_releases(registry):
    status = read_lot_status(registry, LOT.id)
    measured, sampled = (
        [unit.serial for unit in status.on(way)] for way in (Disposition.MEASURED, Disposition.SAMPLED)
    )
    near, firm, new = *sampled, "U99"
    forecasts_N = {near: 0.98 * 0.5 / status.decided.decision.factor, firm: 0.02, new: 0.02}
    for serial in (near, firm):
        store_result(registry, LOT.id, serial, calibrated(registry, serial, 1, forecasts_N[serial]), "batch")
    decide_lot(registry, LOT.id)
    assert set(decision_in_force(registry, LOT.id).released) == {near, firm}
    # A batch is at work: its unit is calibrated, and nobody has decided on it.
    store_result(registry, LOT.id, new, calibrated(registry, new, 0, forecasts_N[new]), "batch")
    bring_audit(registry, measured[0], 1.04, 9)
    in_force, status = decision_in_force(registry, LOT.id), read_lot_status(registry, LOT.id)
    assert [unit.serial for unit in status.on(Disposition.SAMPLED)] == [firm] == list(in_force.released)
    values = in_force.statement.values["first"].values
    assert (values["released"], values["open"]) == (1, 2)


def test_what_an_audit_says_of_other_units_does_not_end_with_a_trim_of_its_own(registry):
    status = read_lot_status(registry, LOT.id)
    measured, sampled = (
        {unit.serial for unit in status.on(way)} for way in (Disposition.MEASURED, Disposition.SAMPLED)
    )
    for serial in sorted(measured)[:3]:
        trim_unit(registry, serial, 0.9)
    check_surfaces(registry)
    after = read_lot_status(registry, LOT.id)
    assert {unit.serial for unit in after.on(Disposition.SAMPLED)} == sampled == set(after.decided.released)
    assert after.decided.qualification.lot_audits == status.decided.qualification.lot_audits
    decide_lot(registry, LOT.id)
    assert {unit.serial for unit in read_lot_status(registry, LOT.id).on(Disposition.SAMPLED)} == sampled


def test_a_few_histories_hold_what_they_promise(two_registries):
    assert run_histories(two_registries, 3, 3) >= 3


@pytest.mark.long
@pytest.mark.timeout(0)
def test_two_thousand_histories_hold_what_they_promise(two_registries):
    assert run_histories(two_registries, 2000, 6) >= 2000
