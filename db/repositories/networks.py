"""Shared networks, and which the line may use: released or withdrawn; all others are drafts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, cast

from sqlalchemy import RowMapping, select

from softcal.core.errors import InputError, NoSuchNetwork
from softcal.db.entries import NetworkEntry
from softcal.db.repositories.registry_base import RegistryBase, entry_from_row
from softcal.db.schema.arrays import get_arrays, put_arrays
from softcal.db.schema.tables import network_releases, networks

if TYPE_CHECKING:
    from softcal.core.identity import Settings
    from softcal.core.network.network import Network
    from softcal.core.recording import Array

DRAFT, RELEASED, WITHDRAWN = "draft", "released", "withdrawn"
ACTIONS = {RELEASED: "release", WITHDRAWN: "withdraw"}
"""State → what the audit trail calls the decision."""


@dataclass(frozen=True)
class NetworkState:
    """State of a network for the line (draft, released, withdrawn) with its time, actor and reason."""

    network: NetworkEntry
    state: str
    since: datetime
    actor: str = ""
    reason: str = ""


class NetworkTables(RegistryBase):
    """Shared networks, and which of them the line may use."""

    def add(
        self,
        lot_id: str,
        network: Network,
        metrics: Mapping[str, object],
        settings: Settings,
        input_sha256: str,
        *,
        actor: str | None = None,
    ) -> str:
        """Store a shared network and return its id, or the id of a stored network of the same input."""
        with self.database.writing():
            self._lot_row(lot_id)
            stored = self.find(input_sha256)
            same = select(networks.c.id).where(networks.c.id == network.id)
            if stored is not None or self.database.row(same) is not None:
                return stored or network.id
            values: dict[str, object] = {"id": network.id, "lot_id": lot_id, "input_sha256": input_sha256}
            values |= {"settings": network.settings(), "training": dict(settings), "metrics": dict(metrics)}
            blob = put_arrays(self.database, network.arrays())
            self._store(networks, values | {"blob_sha256": blob, "added_at": self.settings.clock()}, "add", actor)
            return network.id

    def find(self, input_sha256: str) -> str | None:
        """Return the id of the first network trained from this input, or None."""
        query = select(networks.c.id).where(networks.c.input_sha256 == input_sha256)
        first: str | None = self.database.value(query.order_by(networks.c.added_at, networks.c.id).limit(1))
        return first

    def get(self, network_id: str) -> Network:
        """Return a network by its id, or raise `InputError`."""
        from softcal.core.network.network import Network

        with self.database.reading():
            row = self._network_row(network_id)
            arrays = cast("dict[str, Array]", get_arrays(self.database, row["blob_sha256"]))
            return Network.from_arrays(arrays, row["settings"])

    def entry(self, network_id: str) -> NetworkEntry:
        """Return the metadata of a network without weights; raise `InputError` for an unknown network."""
        with self.database.reading():
            return entry_from_row(NetworkEntry, self._network_row(network_id))

    def all(self) -> list[NetworkEntry]:
        """Return the metadata of every network without weights, oldest first."""
        query = select(networks).order_by(networks.c.added_at, networks.c.id)
        return [entry_from_row(NetworkEntry, row) for row in self.database.rows(query)]

    def _network_row(self, network_id: str) -> RowMapping:
        row = self.database.row(select(networks).where(networks.c.id == network_id))
        if row is None:
            raise NoSuchNetwork(f"network {network_id[:12]} is not in the registry")
        self._check_row(networks, row)
        return row

    def states(self, lot_id: str) -> list[NetworkState]:
        """Return every network of a lot with its state, oldest network first.

        The first network of a lot needs no decision, since there is no other.
        """
        of_lot = [entry for entry in self.all() if entry.lot_id == lot_id]
        decided = self._decisions(lot_id)
        return [
            decided.get(entry.id) or NetworkState(entry, RELEASED if entry is of_lot[0] else DRAFT, entry.added_at)
            for entry in of_lot
        ]

    def released(self, lot_id: str) -> NetworkState | None:
        """Return the released network of a lot: the one that was released last, or None."""
        released = [state for state in self.states(lot_id) if state.state == RELEASED]
        return max(released, key=lambda state: state.since) if released else None

    def release(self, network_id: str, *, reason: str, actor: str | None = None) -> None:
        """Release a network for the line, in place of the present one.

        `InputError`: no reason, no such network, or it is the one in use.
        """
        entry = self.entry(network_id)
        current = self.released(entry.lot_id)
        if current is not None and current.network.id == network_id:
            raise InputError(f"network {network_id[:12]} is the one in use; nothing was changed")
        self._decide(entry, RELEASED, reason, actor)

    def withdraw(self, network_id: str, *, reason: str, actor: str | None = None) -> None:
        """Withdraw a released network; the network released before it is in use again.

        `InputError`: no reason, no such network, or it is not released.
        """
        entry = self.entry(network_id)
        states = {state.network.id: state.state for state in self.states(entry.lot_id)}
        if states[network_id] != RELEASED:
            raise InputError(f"network {network_id[:12]} is {states[network_id]}, not released; nothing was changed")
        self._decide(entry, WITHDRAWN, reason, actor)

    def _decide(self, entry: NetworkEntry, state: str, reason: str, actor: str | None) -> None:
        if not reason.strip():
            raise InputError(f"network {entry.id[:12]}: a reason was expected; nothing was changed")
        with self.database.writing():
            decisions = self._decisions(entry.lot_id)
            made_at = self._after(max((decision.since for decision in decisions.values()), default=None))
            values = {"network_id": entry.id, "made_at": made_at, "origin": self.origin, "lot_id": entry.lot_id}
            values |= {"state": state, "actor": self._actor(actor), "reason": reason}
            self._store(network_releases, values, ACTIONS[state], actor, reason)

    def _decisions(self, lot_id: str) -> dict[str, NetworkState]:
        """Return the newest decision on each network of a lot."""
        c, by_id = network_releases.c, {entry.id: entry for entry in self.all()}
        query = select(c.network_id, c.state, c.made_at, c.actor, c.reason).where(c.lot_id == lot_id)
        rows = self.database.tuples(query.order_by(c.made_at, c.origin))
        return {network_id: NetworkState(by_id[network_id], *decision) for network_id, *decision in rows}
