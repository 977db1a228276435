"""An OPC UA server over the registry: every station and lot now, and every event.

A client that was away loses nothing. It keeps the cursor that `Events/Read` gave last and reads on
from there, across restarts of this server, too. `Events/Cursor` changes with every event; a
subscription to it says when to read.
"""

import asyncio
import json
import logging
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

from asyncua import Node, Server, ua, uamethod
from asyncua.crypto.permission_rules import User as Peer
from asyncua.crypto.permission_rules import UserRole

from softcal.app.connect.events import PUBLIC_KINDS, events_after, list_decided_lots, path_part
from softcal.app.connect.settings import OpcUaSettings
from softcal.app.connect.stations import stations_json
from softcal.core.errors import InputError, SoftcalError
from softcal.db.access.people import may
from softcal.db.queues.outbox import Cursor, cursor_of, cursor_text
from softcal.db.registry import Registry

NAMESPACE, APPLICATION = "urn:softcal:registry", "urn:softcal:server"
MAX_EVENTS = 500
"""Events of one call of `Read` at most."""

TEXT, COUNT = ua.VariantType.String, ua.VariantType.Int64
STATION = {
    "State": "state",
    "Serial": "serial",
    "LastSerial": "last_serial",
    "LastLot": "last_lot",
    "LastVerdict": "last_verdict",
    "Lot": "lot",
}
"""Variable of a station's node → what of `station_json` it shows; "" where there is nothing."""

VERDICTS = {"Pass": "pass", "Conditional": "conditional", "Fail": "fail", "Retest": "retest", "Open": "none"}
"""Variable → units of the lot with this verdict."""


class _TokenAuthenticator:
    """Accepts an account's token; on this machine alone, every user. No client may write."""

    def __init__(self, registry: Registry, is_open: bool) -> None:
        self._registry, self._is_open = registry, is_open

    def get_user(  # noqa: V105
        self,
        iserver: Any,  # noqa: V107
        username: str | None = None,
        password: str | None = None,
        certificate: Any = None,  # noqa: V107
    ) -> Peer | None:
        if self._is_open:
            return Peer(role=UserRole.User)
        try:
            user = self._registry.tokens.user_of(password or "")
        except SoftcalError:
            return None
        return Peer(role=UserRole.User, name=user.name) if user.name == username and may(user, "look") else None


class OpcUaServer:
    """The nodes of a running server and how they follow the registry."""

    def __init__(self, server: Server, registry: Registry, index: int) -> None:
        self._server, self._registry, self._index = server, registry, index
        self._nodes: dict[str, Node] = {}
        self._published: dict[str, Any] = {}
        self._cursor: Cursor | None = None

    async def build(self) -> None:
        """Make the folders and the method of the events."""
        root = await self._folder(self._server.nodes.objects, "Softcal", "Softcal")
        for name in ("Stations", "Lots", "Events"):
            await self._folder(root, name, name)
        await self._write_variable("Events", "Cursor", "", TEXT)
        read = uamethod(self._read)
        await self._nodes["Events"].add_method(*self._node_id("Events/Read", "Read"), read, [TEXT, COUNT], [TEXT, TEXT])

    async def follow(self) -> None:
        """Update the nodes from the registry; nodes of stations and lots appear with them."""
        cursor, stations, lots = await asyncio.to_thread(self._read_registry)
        for station in stations:
            path = f"Stations/{path_part(station['station'])}"
            await self._object("Stations", path, station["station"])
            for name, key in STATION.items():
                await self._write_variable(path, name, station[key] or "", TEXT)
            await self._counts(path, station["counts"])
        for lot_id, counts in lots.items():
            path = f"Lots/{path_part(lot_id)}"
            await self._object("Lots", path, lot_id)
            await self._counts(path, counts)
        # Last, so that who is told of it finds everything else as it is now.
        await self._write_variable("Events", "Cursor", cursor, TEXT)

    def _read_registry(self) -> tuple[str, list[dict[str, Any]], dict[str, dict[str, int]]]:
        registry = self._registry
        changed, self._cursor = list_decided_lots(registry, self._cursor)
        lots = {lot_id: registry.pages.verdict_counts(lot_id) for lot_id in changed}
        return cursor_text(self._cursor), stations_json(registry), lots

    async def _counts(self, path: str, counts: dict[str, int]) -> None:
        for name, verdict in VERDICTS.items():
            await self._write_variable(path, name, counts.get(verdict, 0), COUNT)

    async def _read(self, parent: ua.NodeId, after: str, count: int) -> Any:
        try:
            max_count = max(1, min(count, MAX_EVENTS))
            page = await asyncio.to_thread(
                events_after, self._registry, cursor_of(after or ""), max_count, PUBLIC_KINDS
            )
        except InputError as error:
            logging.getLogger(__name__).info("refused: %s", error)
            return ua.StatusCode(ua.StatusCodes.BadInvalidArgument)
        return cursor_text(page.cursor), json.dumps([event.to_json() for event in page.events], ensure_ascii=False)

    def _node_id(self, path: str, name: str) -> tuple[ua.NodeId, ua.QualifiedName]:
        return ua.NodeId(path, self._index), ua.QualifiedName(name, self._index)

    async def _folder(self, parent: Node, path: str, name: str) -> Node:
        folder = await parent.add_folder(*self._node_id(path, name))
        self._nodes[path] = folder
        return folder

    async def _object(self, parent: str, path: str, name: str) -> None:
        if path not in self._nodes:
            self._nodes[path] = await self._nodes[parent].add_object(*self._node_id(path, name))

    async def _write_variable(self, parent: str, name: str, value: Any, kind: ua.VariantType) -> None:
        path = f"{parent}/{name}"
        if path not in self._nodes:
            self._nodes[path] = await self._nodes[parent].add_variable(*self._node_id(path, name), value, kind)
        elif self._published.get(path) != value:
            await self._nodes[path].write_value(value, kind)
        self._published[path] = value


@asynccontextmanager
async def opcua_server(registry: Registry, settings: OpcUaSettings) -> AsyncIterator[OpcUaServer]:
    """Serve inside the block; raise `InputError` for an unusable address or certificate."""
    is_open = settings.cert_file is None
    server = Server(user_manager=_TokenAuthenticator(registry, is_open))  # type: ignore[arg-type]
    await server.init()
    server.set_endpoint(settings.endpoint)
    server.set_server_name("softcal")
    await server.set_application_uri(APPLICATION)
    if settings.cert_file is None or settings.key_file is None:
        server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        server.set_identity_tokens([ua.AnonymousIdentityToken])
    else:
        server.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
        server.set_identity_tokens([ua.UserNameIdentityToken])
        try:
            await server.load_certificate(str(settings.cert_file))
            await server.load_private_key(str(settings.key_file))
        except (OSError, ValueError) as error:
            raise InputError(f"certificate {settings.cert_file} cannot be read: {error}") from error
    node_server = OpcUaServer(server, registry, await server.register_namespace(NAMESPACE))
    await node_server.build()
    await node_server.follow()
    try:
        await server.start()
    except OSError as error:
        raise InputError(f"nobody can listen at {settings.endpoint}: {error.strerror or error}") from error
    try:
        yield node_server
    finally:
        await server.stop()


async def serve_opcua(
    registry: Registry, settings: OpcUaSettings, is_stopping: Callable[[], bool], on_trouble: Callable[[str], None]
) -> None:
    """Serve until `is_stopping`; a registry that is away for a moment is asked again."""
    async with opcua_server(registry, settings) as node_server:
        while not is_stopping():
            try:
                await node_server.follow()
            except SoftcalError as error:
                on_trouble(f"OPC UA: {error}")
            await asyncio.sleep(settings.every_s)
