"""What stands at a line beside its runs: the unit that waits, the last sentence, the badge.

It lies in the registry, a row a station: every screen shows the same, also after a restart.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime, timedelta

from softcal.db.queues.order_queue import LinePlaces

SHIFT = timedelta(hours=10)
"""A badge names whoever stands at the line for one shift."""


@dataclass(frozen=True)
class Note:
    """One sentence about the last scan.

    Args:
        key: of the text `note.KEY`.
        run: the newest run when it was said; a later run ends it.
    """

    key: str
    values: Mapping[str, str] = field(default_factory=dict)
    is_refusal: bool = True
    run: str = ""
    is_meanwhile: bool = False


@dataclass(frozen=True)
class Place:
    """What stands at a line.

    Args:
        version: counts the changes; 0 where nobody was there yet.
        after_run: the newest run when the unit in the hand last changed or became unknown; None: nothing since its
            run. Once there is a newer run, it alone says what stands at the line.
        serial: scanned and not pressed yet; "" where nobody knows which unit is in the hand.
        is_golden: whether that serial is a golden unit, pressed to check the station.
        is_new: whether the lot has neither that serial nor one that looks like it.
        is_confirmed: whether a person has said yes to a unit that is new, or has a result already.
        process: the station's service when it was scanned; another one has moved the stage since.
        lot_id: chosen by a scan; "" leaves it to the only one, or the last one used.
    """

    version: int = 0
    after_run: str | None = None
    serial: str = ""
    is_golden: bool = False
    is_new: bool = False
    is_confirmed: bool = False
    process: str = ""
    lot_id: str = ""
    tab: str = ""
    note: Note | None = None
    operator: str = ""
    badged_at: datetime | None = None

    def emptied(self, newest_run: str) -> "Place":
        """Return the place once nobody knows which unit is in the hand."""
        return replace(self, after_run=newest_run, serial="", is_golden=False, is_new=False, is_confirmed=False)

    def is_badge_over(self, now: datetime) -> bool:
        """Whether the badge was scanned longer than a shift ago."""
        return self.badged_at is not None and now - self.badged_at > SHIFT


def read_place(places: LinePlaces, station: str) -> Place:
    """Return what stands at the line of a station."""
    version, values = places.read(station)
    if not values:
        return Place(version)
    note, badged_at = values.get("note"), values.get("badged_at")
    facts = {
        "note": Note(**note) if note else None,
        "badged_at": datetime.fromisoformat(badged_at).astimezone(UTC) if badged_at else None,
    }
    return Place(version, **{**values, **facts})


def write_place(places: LinePlaces, station: str, place: Place) -> bool:
    """Put another place there; False, and nothing changed, where a screen was first."""
    values = asdict(place) | {"badged_at": place.badged_at.isoformat() if place.badged_at else None}
    return places.write(station, values.pop("version"), values)
