"""What the screens show, computed without Streamlit: the lot at a glance, one unit in full."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np

from softcal.core.calibration import Calibration
from softcal.core.estimate import Estimate, estimate
from softcal.core.explanation import Explanation, explain
from softcal.core.lot import Lot
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.source_model import make_source_model
from softcal.core.windows import TAPS
from softcal.db.entries import StoredCalibration, UnitEntry
from softcal.db.registry import Registry

VERDICTS = ("pass", "conditional", "fail", "retest")
CURVE_POINTS = 200


@dataclass(frozen=True)
class LotView:
    """A lot at a glance.

    Args:
        lot: its facts, with the newest limit.
        units: target units with their newest result, by serial.
    """

    lot: Lot
    units: tuple[UnitEntry, ...]

    @property
    def judged(self) -> tuple[UnitEntry, ...]:
        """Units that have a verdict."""
        return tuple(unit for unit in self.units if unit.verdict is not None)

    @property
    def counts(self) -> Mapping[str, int]:
        """Units by verdict."""
        return {word: sum(unit.verdict == word for unit in self.units) for word in VERDICTS}

    @property
    def share_passed(self) -> float | None:
        """Units that pass of all that were judged; None before the first."""
        return self.counts["pass"] / len(self.judged) if self.judged else None

    @property
    def predicted(self) -> Array:
        """Predicted error of the units that have one, in the reference unit."""
        return np.array([unit.predicted_rmse for unit in self.units if unit.predicted_rmse is not None], dtype=float)

    @property
    def audited(self) -> tuple[UnitEntry, ...]:
        """Units with a score against a reference."""
        return tuple(unit for unit in self.units if unit.after_rmse is not None)

    @property
    def after_to_own(self) -> float | None:
        """Median of after / own over the audited units; None where none has both."""
        ratios = [unit.after_rmse / unit.own_rmse for unit in self.audited if unit.after_rmse and unit.own_rmse]
        return median(ratios) if ratios else None

    @property
    def needing_a_look(self) -> tuple[UnitEntry, ...]:
        """Units that did not pass, the worst verdict first."""
        return tuple(sorted((u for u in self.judged if u.verdict != "pass"), key=_by_severity))


def _by_severity(unit: UnitEntry) -> tuple[int, float]:
    return -VERDICTS.index(unit.verdict or "pass"), -(unit.predicted_rmse or 0.0)


def lot_view(registry: Registry, lot_id: str) -> LotView:
    """Read a lot at a glance."""
    units = tuple(unit for unit in registry.units(lot_id) if unit.role == "target")
    return LotView(registry.lot(lot_id), units)


@dataclass(frozen=True, eq=False)
class UnitView:
    """One revision of one unit in full.

    Args:
        stored: the revision as the registry has it.
        calibration: the same, ready to estimate with.
        lot: facts of its lot.
        source: labelled recording of the lot's source unit.
        recording: the unit's own recording.
        estimate: f∘γ over that recording.
        explanation: why the verdict is what it is.
    """

    stored: StoredCalibration
    calibration: Calibration
    lot: Lot
    source: LabelledRecording
    recording: OutputRecording
    estimate: Estimate
    explanation: Explanation

    @property
    def mapped(self) -> Array:
        """(m,) newest sample of every mapped window, in the source's output."""
        return self.calibration.unit_map.apply(self.recording.windows)[:, -1]

    def map_curve(self) -> tuple[Array, Array]:
        """Return (levels, levels as the source would show them) of a unit at rest, over the unit's own range."""
        low, high = float(self.recording.output.min()), float(self.recording.output.max())
        level = np.linspace(low, high, CURVE_POINTS)
        return level, self.calibration.unit_map.apply(np.repeat(level[:, None], TAPS, axis=1))[:, -1]

    @property
    def flagged(self) -> int:
        """Rows that are not to be trusted."""
        return int(np.sum(self.estimate.flag != ""))


def unit_view(registry: Registry, serial: str, revision: int | None = None) -> UnitView:
    """Read one revision of a unit in full, the one in use without a number.

    Raises:
        InputError: the registry has no calibration of the serial.
    """
    stored = registry.calibration(serial, revision)
    calibration = Calibration.from_record(stored.record)
    network = registry.network(stored.record.network_id)
    recording = registry.recording(stored.record.recording_sha256)
    unlabelled = recording.unlabelled if isinstance(recording, LabelledRecording) else recording
    source = registry.recording(registry.recordings(stored.lot_id, kind="source")[-1].sha256)
    if not isinstance(source, LabelledRecording):
        raise ValueError("a source recording without reference")
    return UnitView(
        stored,
        calibration,
        registry.lot(stored.lot_id),
        source,
        unlabelled,
        estimate(network, calibration, unlabelled),
        explain(make_source_model(source, network), calibration, unlabelled),
    )


def number(value: float | None, unit: str = "") -> str:
    """Return a number with three significant digits and its unit; a dash where there is none."""
    return "–" if value is None else f"{value:.3g} {unit}".strip()


def thinned(values: Sequence[float] | Array, most: int = 4000) -> slice:
    """Return the slice that leaves at most so many points of a long series for a chart."""
    return slice(None, None, max(1, len(values) // most))
