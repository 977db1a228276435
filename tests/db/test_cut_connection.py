"""A connection that is cut: what reads, and what cannot have been kept, is done once more; nothing is done twice."""

import pytest
from sqlalchemy import text

from softcal.app.cli.main import main
from softcal.core.errors import RegistryError
from softcal.db.connection import open_registry
from softcal.db.queues.work_queue import WorkQueue, WorkSet
from softcal.db.repositories import history
from softcal.db.repositories.calibrations import CalibrationTables
from softcal.db.schema import database as database_module
from softcal.db.schema.database import ConnectionCut

pytestmark = pytest.mark.parametrize("registry_url", ["postgresql"], indirect=True)


@pytest.fixture
def server(factory, monkeypatch):
    """A lot with a unit on PostgreSQL."""
    monkeypatch.setattr(database_module, "AGAIN_AFTER_S", 0.0)
    factory.calibrate("A1", 1)
    return factory


@pytest.fixture
def cut(server, postgresql_admin):
    """`cut()` ends every connection of softcal to the database, as a firewall or a restart does."""
    name = server.registry.database.engine.url.database
    query = text("SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = :name")
    return lambda: postgresql_admin.execute(query, {"name": name}).all()


def cut_at(monkeypatch, cut, module, name: str, times: int) -> list[str]:
    """Cut the connection in the middle of a transaction: as a function that every write goes through is called."""
    original, calls = getattr(module, name), []

    def cutting(*arguments, **options):
        calls.append(name)
        if len(calls) <= times:
            cut()
        return original(*arguments, **options)

    monkeypatch.setattr(module, name, cutting)
    return calls


def test_a_connection_cut_while_it_idled_is_not_noticed(server, cut):
    cut()
    assert server.registry.calibrations.get("A1").revision == 1
    cut()
    assert server.calibrate("A1", 2) == 2


def test_a_read_that_is_cut_is_done_once_more(server, cut, monkeypatch):
    calls = cut_at(monkeypatch, cut, history, "origins", 1)
    assert server.registry.calibrations.get("A1").revision == 1 and len(calls) > 1


def test_a_write_that_is_cut_before_it_is_kept_is_done_once_more_and_once(server, cut, monkeypatch):
    calls = cut_at(monkeypatch, cut, history, "row_hash", 1)
    assert server.calibrate("A1", 2) == 2 and len(calls) > 1
    assert [stored.revision for stored in server.registry.calibrations.history("A1")] == [1, 2]
    assert server.registry.verify() == []


def test_a_server_that_cuts_twice_is_reported_in_one_line(server, cut, monkeypatch):
    calls = cut_at(monkeypatch, cut, history, "row_hash", 99)
    with pytest.raises(ConnectionCut) as error:
        server.calibrate("A1", 2)
    assert error.value.was_repeated and len(calls) == 2
    monkeypatch.undo()
    assert [stored.revision for stored in server.registry.calibrations.history("A1")] == [1]


def test_what_may_have_been_kept_is_not_done_again(server, monkeypatch):
    registry, commits = server.registry, []

    def commit(dialect, connection):
        commits.append(1)
        connection.commit()
        raise dialect.loaded_dbapi.OperationalError("server closed the connection unexpectedly")

    monkeypatch.setattr(type(registry.database.engine.dialect), "do_commit", lambda d, c: commit(d, c))
    with pytest.raises(RegistryError):
        server.calibrate("A1", 2)
    monkeypatch.undo()
    assert len(commits) == 1 and [stored.revision for stored in registry.calibrations.history("A1")] == [1, 2]


def test_inside_a_larger_transaction_nothing_is_repeated_alone(server, cut):
    with pytest.raises(ConnectionCut), server.registry.transaction():
        server.calibrate("A1", 2)
        cut()
        server.calibrate("A2", 2)
    assert [unit.serial for unit in server.registry.lots.units("L1") if unit.revision] == ["A1"]
    assert server.registry.verify() == []


def test_a_queue_s_claim_that_was_cut_is_claimed_once(server, cut, monkeypatch):
    queue, work = server.registry.work_queue, WorkSet("L1", "a" * 64)
    queue.enqueue(work, {f"A{k}": f"{k:064x}" for k in range(4)})
    original, calls = WorkQueue._free, []

    def cutting(*arguments):
        result = original(*arguments)
        calls.append(1)
        if len(calls) == 1:
            cut()
        return result

    monkeypatch.setattr(WorkQueue, "_free", cutting)
    assert len(queue.claim("me", work, 3, 60)) == 3
    assert queue.counts("L1") == {"queued": 1, "claimed": 3, "failed": 0}


def test_a_batch_goes_on_through_a_cut(server, cut, trained_lot, tmp_path, monkeypatch, capsys):
    url = server.registry.database.engine.url.render_as_string(hide_password=False)
    command = ["batch", str(trained_lot / "lot"), "--registry", url, "--hidden", "16,8", "--no-own"]
    original, calls = CalibrationTables.add, []

    def cutting(*arguments, **options):
        answer = original(*arguments, **options)
        calls.append(1)
        if len(calls) == 1:
            cut()
        return answer

    monkeypatch.setattr(CalibrationTables, "add", cutting)
    assert main(command) in (0, 1), capsys.readouterr().err
    assert len(calls) > 3
    with open_registry(url, create=False) as registry:
        units = {unit.serial: unit.revision for unit in registry.lots.units("small") if unit.role == "target"}
        revisions = {"A1": 2, "A2": 1, "A3": 1}
        assert units == revisions, "A1 has a revision in the other lot"
        assert registry.verify() == []
