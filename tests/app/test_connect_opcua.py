"""OPC UA with a real client: nodes of stations and lots, every verdict across a restart, nobody writes, sign-in."""

import asyncio
import json
from collections.abc import Coroutine, Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TypeVar

import pytest
from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256

from softcal.app.connect.events import events_after
from softcal.app.connect.opcua import NAMESPACE, opcua_server
from softcal.app.connect.settings import OpcUaSettings
from softcal.core.errors import InputError
from softcal.core.lot import Lot
from softcal.core.messages.reason import plain
from softcal.core.orders import Heartbeat, Order, OrderKind, Progress, RunState, StationState
from softcal.db.connection import open_registry
from softcal.db.registry import Registry

pytestmark = pytest.mark.long

VERDICTS = 1000
T = TypeVar("T")


def run(work: Coroutine[object, object, T]) -> T:
    """Run it in a thread of its own: a browser of another test may keep the loop of this one."""
    with ThreadPoolExecutor(1) as alone:
        return alone.submit(asyncio.run, work).result()


@pytest.fixture
def registry(tmp_path: Path) -> Iterator[Registry]:
    with open_registry(f"sqlite:///{tmp_path / 'registry.db'}") as opened:
        opened.lots.add(Lot("L1", "S0", 50.0))
        yield opened


@pytest.fixture
def settings(some_port) -> OpcUaSettings:
    return OpcUaSettings(endpoint=f"opc.tcp://127.0.0.1:{some_port()}/softcal")


def give_verdicts(registry: Registry, first: int, count: int, verdict: str = "fail") -> None:
    with registry.transaction():
        for number in range(first, first + count):
            registry.calibrations.refuse("L1", f"U{number}", verdict, (plain("dead"),))


async def node(client: Client, path: str):
    index = await client.get_namespace_index(NAMESPACE)
    return client.get_node(ua.NodeId(path, index))


async def value(client: Client, path: str):
    return await (await node(client, path)).read_value()


async def read(client: Client, after: str, count: int) -> tuple[str, list[dict]]:
    events = await node(client, "Events")
    cursor, text = await events.call_method(await node(client, "Events/Read"), after, ua.Variant(count, ua.Int64))
    return cursor, json.loads(text)


class Watcher:
    """A client that reads on whenever the cursor changes, and keeps only its cursor over a restart."""

    def __init__(self) -> None:
        self.after, self.ids = "", []

    async def read_on(self, client: Client) -> None:
        while True:
            self.after, events = await read(client, self.after, 70)
            self.ids += [event["id"] for event in events]
            if not events:
                return


def test_a_client_sees_every_verdict_across_restarts_of_the_server(registry, settings):
    """1,000 verdicts in four parts; the server is gone while one of each two is made, and the client reads on."""
    watcher, share = Watcher(), VERDICTS // 4

    async def collect_events() -> None:
        for part in (0, 2):
            give_verdicts(registry, share * part, share)
            async with opcua_server(registry, settings) as server, Client(settings.endpoint) as client:
                await watcher.read_on(client)
                give_verdicts(registry, share * (part + 1), share)
                await server.follow()
                await watcher.read_on(client)

    run(collect_events())
    expected_ids = [event.event_id for event in events_after(registry, {}, 2 * VERDICTS, ["verdict"]).events]
    assert watcher.ids == expected_ids and len(expected_ids) == VERDICTS


def test_a_subscription_to_the_cursor_says_when_to_read(registry, settings):
    notifications: asyncio.Queue[str] = asyncio.Queue()

    class Handler:
        def datachange_notification(self, changed, value, data) -> None:
            notifications.put_nowait(value)

    async def subscribe() -> list[str]:
        async with opcua_server(registry, settings) as server, Client(settings.endpoint) as client:
            subscription = await client.create_subscription(20, Handler())
            await subscription.subscribe_data_change(await node(client, "Events/Cursor"))
            before = await asyncio.wait_for(notifications.get(), 30)
            give_verdicts(registry, 0, 1)
            await server.follow()
            assert await asyncio.wait_for(notifications.get(), 30) != before
            _, events = await read(client, before, 10)
            await subscription.delete()
            return [event["data"]["serial"] for event in events]

    assert run(subscribe()) == ["U0"]


def test_a_station_shows_its_state_its_unit_and_the_verdict_of_the_last_one(registry, settings):
    # As far ahead as clocks may be: nobody beats while the test looks.
    queue, ahead = registry.order_queue, datetime.now(UTC) + timedelta(seconds=25)
    queue.write_heartbeat(Heartbeat("line 1", StationState.RUNNING, ahead, process="a:1"))
    queue.place(Order("o1", "line 1", OrderKind.UNIT, "U1", "L1"))
    queue.report(Progress("o1", RunState.DONE, verdict="pass"))
    give_verdicts(registry, 1, 1, "retest")
    queue.place(Order("o2", "line 1", OrderKind.UNIT, "U2", "L1"))

    async def look() -> dict[str, object]:
        async with opcua_server(registry, settings) as server, Client(settings.endpoint) as client:
            names = ("State", "Serial", "LastSerial", "LastLot", "LastVerdict", "Lot", "Retest")
            first = {name: await value(client, f"Stations/line%201/{name}") for name in names}
            give_verdicts(registry, 2, 3)
            await server.follow()
            lot = {name: await value(client, f"Lots/L1/{name}") for name in ("Fail", "Retest", "Pass")}
            return first | {f"lot {name}": count for name, count in lot.items()}

    values = run(look())
    # The run said pass when it was pressed; what holds now is what every page says.
    assert values == {
        "State": "running", "Serial": "U2", "LastSerial": "U1", "LastLot": "L1", "LastVerdict": "retest", "Lot": "L1",
        "Retest": 1,
        "lot Fail": 3, "lot Retest": 1, "lot Pass": 0,
    }  # fmt: skip


def test_nobody_writes_and_a_cursor_that_was_not_given_is_refused(registry, settings):
    async def attempt() -> None:
        async with opcua_server(registry, settings), Client(settings.endpoint) as client:
            cursor = await node(client, "Events/Cursor")
            with pytest.raises(ua.UaStatusCodeError):
                await cursor.write_value("forged")
            with pytest.raises(ua.UaStatusCodeError):
                await client.nodes.objects.add_folder(0, "Mine")
            for after in ("nonsense", "a:b", "x" * 5000):
                with pytest.raises(ua.UaStatusCodeError):
                    await read(client, after, 10)

    run(attempt())


def test_with_a_certificate_an_account_signs_in_with_its_token(registry, settings, tls):
    registry.people.set("scada", "operator", "2580", actor="admin")
    token, secret = registry.tokens.add("scada", "SCADA of hall 3", 1)
    safe = OpcUaSettings(endpoint=settings.endpoint, cert_file=tls.cert, key_file=tls.key)

    async def sign_in(user: str | None, password: str) -> str:
        client = Client(safe.endpoint)
        client.application_uri = "urn:softcal:server"
        await client.set_security(SecurityPolicyBasic256Sha256, str(tls.cert), str(tls.key))
        if user is not None:
            client.set_user(user)
            client.set_password(password)
        async with client:
            return str(await value(client, "Events/Cursor"))

    async def attempt() -> None:
        async with opcua_server(registry, safe):
            assert registry.origin in await sign_in("scada", secret)
            for user, password in ((None, ""), ("scada", "wrong"), ("admin", secret)):
                with pytest.raises(ua.UaError):
                    await sign_in(user, password)
            registry.tokens.withdraw(token.token_id, reason="lost")
            with pytest.raises(ua.UaError):
                await sign_in("scada", secret)

    run(attempt())


@pytest.mark.parametrize(
    "endpoint", ["opc.tcp://0.0.0.0:4840", "opc.tcp://plant.example:4840", "http://127.0.0.1:1", "x"]
)
def test_other_machines_reach_it_only_with_a_certificate(endpoint):
    with pytest.raises(InputError):
        OpcUaSettings(endpoint=endpoint)
