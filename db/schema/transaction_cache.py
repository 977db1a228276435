"""Cache of a transaction: rows read and written so far, so that a chunk of a batch queries them once.

One writer at a time: nobody else can change any of it before the transaction ends. What a savepoint
takes back was never there, so a rollback to one forgets all.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from weakref import WeakKeyDictionary

from sqlalchemy import Connection, RootTransaction, RowMapping

HAS_AUDIT_ROWS = "softcal_has_told"
"""Key in the info of a connection: its transaction wrote into the audit trail."""


@dataclass
class TransactionCache:
    """Cached rows of one transaction.

    Args:
        lots: rows of lots that were compared with the audit trail.
        heads: number and hash of the newest row of a chain of the trail, by registry.
        blobs: hashes of blobs that are stored.
        networks, methods: ids of those that are stored.
        parts: table, lot and hash of parts of states that are stored.
        units: lot and serial of units that are registered.
        without_fit: those of them that were registered here, until their first fit.
        rows: rows of a unit by table, lot and serial, newest first; none of a unit that was registered here.
    """

    lots: dict[str, RowMapping] = field(default_factory=dict)
    heads: dict[str, tuple[int, str]] = field(default_factory=dict)
    blobs: set[str] = field(default_factory=set)
    networks: set[str] = field(default_factory=set)
    methods: set[str] = field(default_factory=set)
    parts: set[tuple[str, str, str]] = field(default_factory=set)
    units: set[tuple[str, str]] = field(default_factory=set)
    without_fit: set[tuple[str, str]] = field(default_factory=set)
    rows: dict[tuple[str, str, str], Sequence[RowMapping]] = field(default_factory=dict)


_by_transaction = WeakKeyDictionary[RootTransaction, TransactionCache]()


def cache_of(connection: Connection) -> TransactionCache:
    """Return the cache of a connection's transaction; None outside a transaction."""
    transaction = connection.get_transaction()
    return TransactionCache() if transaction is None else _by_transaction.setdefault(transaction, TransactionCache())


def clear_cache(connection: Connection, *_: object) -> None:
    """Clear the cache of the transaction."""
    transaction = connection.get_transaction()
    if transaction is not None:
        _by_transaction.pop(transaction, None)
