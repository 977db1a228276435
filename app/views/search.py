"""What a text finds in the registry: units, lots, stations, certificates. No Streamlit."""

from collections.abc import Mapping
from dataclasses import dataclass

from softcal.db.registry import Registry

MAX_HITS = 12


@dataclass(frozen=True)
class SearchHit:
    """One thing that was found, and the page that shows it."""

    kind: str
    name: str
    page: str
    query: Mapping[str, str]


def search(registry: Registry, text: str) -> list[SearchHit]:
    """Return what has a text in its name, in any case; a name that is the text itself alone, where there is one."""
    needle = text.strip().lower()
    if not needle:
        return []
    hits = [SearchHit("lot", lot, "lot", {"lot": lot}) for lot in registry.lots.ids()]
    hits += [
        SearchHit("station", heartbeat.station, "station", {"station": heartbeat.station})
        for heartbeat in registry.order_queue.stations()
    ]
    for certificate in registry.stations.certificates():
        name = f"{certificate.number} · {certificate.cell_serial}"
        hits.append(SearchHit("certificate", name, "station", {"tab": "cells"}))
    hits = [hit for hit in hits if needle in hit.name.lower()]
    for key in registry.pages.find_units(needle):
        hits.append(SearchHit("unit", f"{key.serial} · {key.lot_id}", "unit", {"unit": str(key)}))
    exact = [hit for hit in hits if needle in hit.name.lower().split(" · ")[:1]]
    return (exact or hits)[:MAX_HITS]
