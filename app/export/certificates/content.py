"""The facts of one certificate, gathered once; `pdf.py` and `dcc.py` are two forms of them."""

from dataclasses import dataclass
from datetime import date
from importlib.metadata import version

import numpy as np

from softcal.app.export.calibrated_unit import CalibratedUnit
from softcal.app.export.certificates.laboratory import Laboratory, read_laboratory
from softcal.core.recording import Array
from softcal.core.unit.estimate import Estimate, estimate
from softcal.core.unit.verdict import Verdict

BANDS = 4
"""The range of the reference is told in this many equal bands."""

METHOD = (
    "A time-delay network f (15 output samples to one estimate) was trained on a source unit against a load cell. "
    "The unit's own output was recorded without a reference; a map of its output windows into the source's was found "
    "by optimal transport; the unit's estimate is f of the mapped window (Kim, Kwon, Jeon and Park, 2020, Advanced "
    "Intelligent Systems, 1900178)."
)

DECISION_RULE = (
    "ILAC-G8:09/2019, non-binary statement with guard band w = U (95 %, k = 2): pass where the upper end of the "
    "predicted error is within the limit, conditional pass where the predicted error itself is, conditional fail where "
    "only its lower end is, else fail."
)

NOT_COMPARED = (
    "The error of this unit is predicted from unlabelled data; the unit itself was not compared with a load cell."
)
COMPARED = "The unit was also compared with a reference on an audit recording; the measured error is stated."


@dataclass(frozen=True)
class Uncertainty:
    """The 90 % interval of an estimate in one band of its range, mean over the unit's recording."""

    low: float
    high: float
    half_width: float


@dataclass(frozen=True, eq=False)
class Certificate:
    """What is certified, how it was found and what it rests on. Errors and ranges are in `reference_unit`.

    Args:
        identifier: unique over all certificates of a registry.
        made_on: UTC date of the calibration.
        low, high: range of the source's reference, within which the calibration holds.
        expected, expected_interval: predicted RMSE and its 95 % interval; None where none was made.
        limit, limit_origin: the agreed limit and where it comes from.
        conformity: pass, conditional pass, conditional fail, fail; empty where nothing can be said.
        measured: RMSE on an audit recording; None without one.
        bands: 90 % interval by range of the estimate.
        output, mapped: (k,) output levels of this unit and the source output each stands for.
        estimated: the unit's own recording as estimated.
    """

    identifier: str
    made_on: date
    laboratory: Laboratory
    serial: str
    revision: int
    lot: str
    sensor_model: str
    source: str
    quantity: str
    output_unit: str
    reference_unit: str
    sample_rate_Hz: float
    samples: int
    low: float
    high: float
    expected: float | None
    expected_interval: tuple[float, float] | None
    limit: float | None
    limit_origin: str
    conformity: str
    verdict: str
    reasons: tuple[str, ...]
    before: float | None
    measured: float | None
    map_family: str
    hashes: tuple[tuple[str, str], ...]
    bands: tuple[Uncertainty, ...]
    output: Array
    mapped: Array
    estimated: Estimate
    software: str

    @property
    def basis(self) -> str:
        """Whether the error was predicted or measured."""
        return COMPARED if self.measured is not None else NOT_COMPARED

    @property
    def traceability(self) -> str:
        """What the results are traced to."""
        cell = self.laboratory.load_cell
        chain = f"Traced through source unit {self.source} of lot {self.lot}"
        if cell.is_stated:
            return f"{chain} to load cell {cell.serial}, certificate {cell.certificate} of {cell.laboratory}."
        return f"{chain}; no certificate of its load cell was stated, so the results are not metrologically traceable."


def certificate_of(unit: CalibratedUnit) -> Certificate:
    """Gather the facts of a calibrated unit.

    Raises:
        InputError: the laboratory file cannot be used.
    """
    record, lot = unit.stored.record, unit.lot
    found = estimate(unit.network, unit.calibration, unit.recording)
    forecast = unit.calibration.forecast
    limit = record.evidence.get("limit_rmse")
    output, mapped = _map_curve(unit)
    reference = unit.shared.source.reference
    return Certificate(
        identifier=f"softcal-{record.serial}-r{unit.stored.revision}-{record.map_sha256[:8]}",
        made_on=unit.stored.made_at.date(),
        laboratory=read_laboratory(unit.options.laboratory),
        serial=record.serial,
        revision=unit.stored.revision,
        lot=lot.id,
        sensor_model=lot.sensor_model,
        source=lot.source,
        quantity=lot.reference_quantity,
        output_unit=lot.output_unit,
        reference_unit=lot.reference_unit,
        sample_rate_Hz=lot.sample_rate_Hz,
        samples=len(unit.recording),
        low=float(reference.min()),
        high=float(reference.max()),
        expected=None if forecast is None else forecast.rmse,
        expected_interval=None if forecast is None else (forecast.lower, forecast.upper),
        limit=float(limit) if isinstance(limit, int | float) else None,
        limit_origin=str(record.evidence.get("limit_origin") or ""),
        conformity=Verdict(record.verdict).conformity,
        verdict=record.verdict,
        reasons=tuple(map(str, record.reasons)),
        before=record.before_rmse,
        measured=record.after_rmse,
        map_family=record.family,
        hashes=(
            ("network", record.network_id),
            ("map", record.map_sha256),
            ("unit's recording", record.recording_sha256),
            ("source recording", unit.shared.source_sha256),
        ),
        bands=_bands(found, float(reference.min()), float(reference.max())),
        output=output,
        mapped=mapped,
        estimated=found,
        software=f"softcal {version('softcal')}",
    )


def _bands(found: Estimate, low: float, high: float) -> tuple[Uncertainty, ...]:
    """Mean half-width of the interval in equal bands of the reference's range; empty bands are left out."""
    edges = np.linspace(low, high, BANDS + 1)
    half = (found.upper - found.lower) / 2
    bands = []
    for k in range(BANDS):
        inside = (found.estimate >= edges[k]) & (found.estimate <= edges[k + 1])
        if inside.any():
            bands.append(Uncertainty(float(edges[k]), float(edges[k + 1]), float(half[inside].mean())))
    return tuple(bands)


def _map_curve(unit: CalibratedUnit) -> tuple[Array, Array]:
    """The map at steady outputs, over the range of the unit's recording."""
    output = np.linspace(float(unit.recording.output.min()), float(unit.recording.output.max()), 60)
    windows = np.repeat(output[:, None], unit.recording.windows.shape[1], axis=1)
    return output, unit.calibration.unit_map.apply(windows)[:, -1]
