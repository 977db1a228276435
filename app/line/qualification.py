"""Qualification of a station: its page, and its row for the gate."""

import math
from dataclasses import dataclass
from datetime import date, datetime, timedelta
from pathlib import Path

from softcal.app.files.atomic import write_text
from softcal.core.quality.gate import QualificationAtGate
from softcal.db.registry import Registry
from softcal.station.devices.config import StationConfig
from softcal.station.tasks.qualify import Qualification

HEAD = ("figure", "value", "unit", "at most", "is")


@dataclass(frozen=True)
class QualificationPage:
    """A qualification with its station and time.

    Args:
        station: its name, as orders call it.
        specimen: the pressed unit, in words.
        days: so long it holds.
    """

    station: str
    config: StationConfig
    specimen: str
    qualification: Qualification
    made_at: datetime
    days: int

    @property
    def due_on(self) -> date:
        """First day on which the qualification is no longer valid."""
        return self.made_at.date() + timedelta(days=self.days)

    @property
    def rows(self) -> list[tuple[str, str, str, str, str]]:
        """Figures as texts: name, value, unit, limit, good or not."""
        rows = []
        for figure in self.qualification.figures:
            limit = f"{figure.limit:.3g}" if math.isfinite(figure.limit) else ""
            word = ("good" if limit else "said") if figure.is_good else "NOT GOOD"
            value = f"{figure.value:.3g}" if math.isfinite(figure.value) else "not measured"
            rows.append((figure.name, value, figure.unit, limit, word))
        return rows

    @property
    def verdict(self) -> str:
        """One line: passed or not, and the end of validity."""
        refusal = self.qualification.refusal
        if self.qualification.is_passed:
            return f"PASSED, valid until {self.due_on}"
        return "NOT PASSED" + (f": {refusal}" if refusal is not None else "")

    def write(self, path: Path) -> None:
        """Write the page as Markdown."""
        force = self.config.force
        cell = "none" if force is None else f"{force.serial or 'without serial'} ({force.kind}, {force.capacity_N:g} N)"
        table = "\n".join("| " + " | ".join(row) + " |" for row in [HEAD, ("---",) * len(HEAD), *self.rows])
        write_text(
            path,
            f"# Qualification of station {self.station}\n\n{self.verdict}\n\n"
            f"- made at {self.made_at.isoformat(timespec='seconds')}, in {self.qualification.seconds:.0f} s\n"
            f"- pressed: {self.specimen}\n- load cell: {cell}\n"
            f"- stage: {self.config.stage.kind}; readout: {self.config.readout.kind}\n\n{table}\n",
        )

    def to_json(self) -> dict[str, object]:
        """Return the page as JSON values; a figure without a limit has null there."""
        figures = [
            {
                "name": figure.name,
                "value": figure.value if math.isfinite(figure.value) else None,
                "unit": figure.unit,
                "limit": figure.limit if math.isfinite(figure.limit) else None,
                "is_good": figure.is_good,
            }
            for figure in self.qualification.figures
        ]
        refusal = self.qualification.refusal
        return {
            "station": self.station,
            "specimen": self.specimen,
            "made_at": self.made_at.isoformat(),
            "due_on": self.due_on.isoformat(),
            "is_passed": self.qualification.is_passed,
            "refusal": None if refusal is None else str(refusal),
            "figures": figures,
            "station_s": self.qualification.seconds,
        }


def store_qualification(registry: Registry, page: QualificationPage, actor: str | None = None) -> None:
    """Store a qualification for the gate of its station; the newest is in force."""
    fields = {"station": page.station, "is_passed": page.qualification.is_passed, "due_on": page.due_on}
    registry.declarations.declare(
        "station_qualifications", fields | {"page": page.to_json()}, action="qualify", actor=actor
    )


def newest_qualification(registry: Registry, station: str) -> QualificationAtGate | None:
    """Return the newest qualification of a station, or None."""
    stored = registry.declarations.newest("station_qualifications", station)
    return None if stored is None else QualificationAtGate(stored["is_passed"], stored["due_on"])
