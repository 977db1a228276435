"""Which network of a lot the line may use: released with a reason, withdrawn with a reason; all others are drafts."""

from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import select

from softcal.core.errors import InputError
from softcal.db.entries import NetworkEntry
from softcal.db.schema.tables import network_releases
from softcal.db.truth.recordings import RecordingTables

DRAFT, RELEASED, WITHDRAWN = "draft", "released", "withdrawn"
ACTIONS = {RELEASED: "release", WITHDRAWN: "withdraw"}
"""State → what the audit trail calls the decision."""


@dataclass(frozen=True)
class NetworkState:
    """Whether the line may use a network.

    Args:
        network: what is known of it.
        state: draft, released or withdrawn.
        since: when it became so; of a draft when it was trained.
        actor, reason: who decided it, and why; "" where nobody had to decide.
    """

    network: NetworkEntry
    state: str
    since: datetime
    actor: str = ""
    reason: str = ""


class NetworkReleases(RecordingTables):
    """The part of the registry that knows which networks are released."""

    def network_states(self, lot_id: str) -> list[NetworkState]:
        """Return every network of a lot with its state, oldest network first.

        The first network of a lot needs no decision, since there is no other.
        """
        mine = [entry for entry in self.networks() if entry.lot_id == lot_id]
        decided = self._decisions(lot_id)
        standing = {entry.id for entry in mine[:1]}
        return [
            decided.get(entry.id) or NetworkState(entry, RELEASED if entry.id in standing else DRAFT, entry.added_at)
            for entry in mine
        ]

    def released_network(self, lot_id: str) -> NetworkState | None:
        """Return the network of a lot that the line uses: the one released last; None where there is none."""
        released = [state for state in self.network_states(lot_id) if state.state == RELEASED]
        return max(released, key=lambda state: state.since) if released else None

    def release_network(self, network_id: str, *, reason: str, actor: str | None = None) -> None:
        """Let the line use a network from now on, in place of the one it used.

        Raises:
            InputError: no reason, no such network, or it is the one in use.
        """
        entry = self.network_entry(network_id)
        current = self.released_network(entry.lot_id)
        if current is not None and current.network.id == network_id:
            raise InputError(f"network {network_id[:12]} is the one in use; nothing was changed")
        self._decide(entry, RELEASED, reason, actor)

    def withdraw_network(self, network_id: str, *, reason: str, actor: str | None = None) -> None:
        """Take a released network from the line; the one released before it is in use again, where there is one.

        Raises:
            InputError: no reason, no such network, or it is not released.
        """
        entry = self.network_entry(network_id)
        states = {state.network.id: state.state for state in self.network_states(entry.lot_id)}
        if states[network_id] != RELEASED:
            raise InputError(f"network {network_id[:12]} is {states[network_id]}, not released; nothing was changed")
        self._decide(entry, WITHDRAWN, reason, actor)

    def _decide(self, entry: NetworkEntry, state: str, reason: str, actor: str | None) -> None:
        if not reason.strip():
            raise InputError(f"network {entry.id[:12]}: a reason was expected; nothing was changed")
        with self.database.writing() as connection:
            decisions = self._decisions(entry.lot_id)
            made_at = self._after(max((decision.since for decision in decisions.values()), default=None))
            values = {
                "network_id": entry.id,
                "made_at": made_at,
                "origin": self.origin,
                "lot_id": entry.lot_id,
                "state": state,
                "actor": self._actor(actor),
                "reason": reason,
            }
            self._store(connection, network_releases, values, ACTIONS[state], actor, reason)

    def _decisions(self, lot_id: str) -> dict[str, NetworkState]:
        """Return the newest decision of each network of a lot that somebody decided about."""
        c = network_releases.c
        query = select(network_releases).where(c.lot_id == lot_id).order_by(c.made_at, c.origin)
        known = {entry.id: entry for entry in self.networks()}
        facts = (c.state, c.made_at, c.actor, c.reason)
        return {
            row[c.network_id]: NetworkState(known[row[c.network_id]], *(row[column] for column in facts))
            for row in self.database.rows(query)
        }
