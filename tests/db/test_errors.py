"""What cannot be done is raised as the class a caller can handle, on both databases, and keeps its exit code."""

import threading
from contextlib import closing

import pytest
from sqlalchemy import text

from softcal.core import errors
from softcal.core.lot import UnitKey
from softcal.core.messages.reason import plain
from softcal.db.connection import open_registry
from softcal.db.repositories.in_use import InUseTable
from softcal.db.schema import engines
from softcal.db.schema.database import open_database

MISSING = [
    (errors.NoSuchLot, lambda registry: registry.lots.get("nowhere")),
    (errors.NoSuchLot, lambda registry: registry.calibrations.get("A1", lot_id="nowhere")),
    (errors.NoSuchUnit, lambda registry: registry.calibrations.get("nobody")),
    (errors.NoSuchUnit, lambda registry: registry.calibrations.get("A1", lot_id="L2")),
    (errors.NoSuchRevision, lambda registry: registry.calibrations.get("A1", 9)),
    (errors.NoSuchRevision, lambda registry: registry.adaptations.add(UnitKey("L1", "A1"), 9, [])),
    (errors.NoSuchNetwork, lambda registry: registry.networks.get("f" * 64)),
    (errors.NoSuchRecording, lambda registry: registry.recordings.get("f" * 64)),
    (errors.NoSuchOrder, lambda registry: registry.order_queue.progress("nothing")),
    (errors.NoSuchJob, lambda registry: registry.job_board.job("nothing")),
]


@pytest.mark.parametrize(("kind", "ask"), MISSING, ids=lambda one: getattr(one, "__name__", ""))
def test_what_is_not_in_the_registry_has_a_class_of_its_own(factory, make_factory, kind, ask):
    factory.calibrate("A1")
    make_factory(factory.registry, "L2")
    with pytest.raises(errors.NotInRegistry) as raised:
        ask(factory.registry)
    assert (type(raised.value), raised.value.exit_code) == (kind, 2)


def test_a_serial_of_two_lots_is_ambiguous(factory, make_factory):
    for lot in (factory, make_factory(factory.registry, "L2")):
        lot.calibrate("A1")
    with pytest.raises(errors.AmbiguousUnit):
        factory.registry.calibrations.get("A1")


def test_a_limit_and_a_person_that_somebody_else_changed(factory):
    factory.registry.people.set("kim", "operator", "258013", actor="lee")
    with pytest.raises(errors.ChangedMeanwhile):
        factory.registry.people.set("kim", "quality", None, version=7, actor="lee")
    with pytest.raises(errors.ChangedMeanwhile):
        factory.registry.lots.set_limit("L1", 0.5, expected_version=7, reason="agreed", actor="lee")
    with pytest.raises(errors.SignInRefused):
        factory.registry.people.sign_in("kim", "999999")


def test_a_registry_that_is_not_there_and_one_of_another_schema(new_url):
    url = new_url()
    with pytest.raises(errors.RegistryError) as raised:
        open_registry(url, create=False)
    assert raised.value.exit_code == 4 and (isinstance(raised.value, errors.NoRegistry) or url.startswith("sqlite"))
    open_registry(url).close()
    with closing(open_database(url)) as database:
        database.change(text("UPDATE alembic_version SET version_num = '0010'"))
    with pytest.raises(errors.WrongSchema):
        open_registry(url)


def test_a_registry_that_another_holds_is_busy_and_nothing_changes(registry_url, monkeypatch):
    monkeypatch.setattr(engines, "SQLITE_WAIT_S", 0.3)
    with open_registry(registry_url) as one, open_registry(registry_url) as other:
        is_locked, is_over = threading.Event(), threading.Event()

        def hold() -> None:
            with one.database.writing() as connection:
                connection.execute(text("UPDATE registry_info SET value = value"))
                is_locked.set()
                is_over.wait(30)

        holder = threading.Thread(target=hold)
        holder.start()
        try:
            assert is_locked.wait(30)
            with pytest.raises(errors.RegistryBusy), other.database.writing(in_turn=False) as connection:
                if not other.database.is_sqlite:
                    connection.execute(text("SET LOCAL lock_timeout = '300ms'"))
                connection.execute(text("UPDATE registry_info SET value = value"))
        finally:
            is_over.set()
            holder.join()


def test_two_registries_that_name_different_maps_are_a_conflict(factory, monkeypatch):
    factory.calibrate("A1")
    monkeypatch.setattr("softcal.db.repositories.in_use.names_several", lambda *_: True)
    with pytest.raises(errors.MapsConflict):
        InUseTable._in_use(factory.registry.calibrations, "L1", "A1")


def test_every_error_has_an_exit_code_of_the_contract_and_a_line():
    kinds = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, errors.SoftcalError)]
    assert {kind.exit_code for kind in kinds} == {2, 3, 4}
    for kind in kinds:
        assert str(kind(plain("two\nlines"))) == "two\\nlines"
        assert kind.exit_code == (
            3 if issubclass(kind, errors.DeviceError) else 4 if issubclass(kind, errors.RegistryError) else 2
        )
