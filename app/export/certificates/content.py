"""The facts of one certificate, gathered once; `pdf.py` and `dcc.py` are two forms of them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime
from importlib.metadata import version

import numpy as np

from softcal.app.export.calibrated_unit import CalibratedUnit
from softcal.app.export.certificates.laboratory import NOT_STATED, Laboratory, read_laboratory
from softcal.core.errors import InputError
from softcal.core.recording import Array
from softcal.core.unit.budget import COVERAGE, Budget, Reference, Standing, forecast_budget, measured_budget
from softcal.core.unit.estimate import Estimate, estimate
from softcal.core.unit.uncertainty import NORMAL_90
from softcal.core.unit.verdict import Verdict

BANDS = 4
"""The range of the reference is told in this many equal bands."""

PAPER = "Kim, Kwon, Jeon and Park, 2020, Advanced Intelligent Systems, 1900178"

METHODS: Mapping[str, tuple[str, str]] = {
    "identity": ("the source's network unchanged", "The unit's windows were taken as the source's, unchanged"),
    "affine": ("one gain and offset", "A gain and an offset were found from the distributions of both outputs"),
    "label_shift": (
        "label shift",
        "A gain and an offset were found from rest and peak of the unit's output, blind to how long and how fast it "
        "was pressed (label shift)",
    ),
    "monotone": (
        "monotone transport",
        "Equal quantiles of both outputs were matched (one-dimensional optimal transport)",
    ),
    "between": (
        "half way between rest and peak, and equal quantiles",
        "The line through rest and peak of both outputs was averaged with the curve through their equal quantiles",
    ),
    "synchronous": (
        "pairs at equal time",
        "Unit and source were pressed by one load at once; the map was fitted to the pairs of their windows",
    ),
    "phase": (
        "pairs at equal stage position",
        "The map was fitted to pairs of windows at equal stage positions of unit and source",
    ),
    "exact": ("exact optimal transport", f"Windows were matched by exact discrete optimal transport ({PAPER}, eq. 3)"),
    "joint": (
        "joint transport of windows and labels",
        "Windows and estimates were matched together by joint optimal transport (Courty et al. 2017)",
    ),
}
"""By family of the map: its name, and how it was found."""

DECISION_RULE = (
    "ILAC-G8:09/2019, non-binary statement with guard band w = U (95 %, k = 2): pass where the upper end of the "
    "predicted or measured error is within the acceptance limit, conditional pass where the error itself is within the "
    "limit, conditional fail where only its lower end is, else fail. Acceptance limit: the root of limit squared minus "
    "U squared of the reference (k = 2)."
)

NOT_COMPARED = (
    "The error of this unit is predicted from unlabelled data; the unit itself was not compared with a load cell."
)
COMPARED = "The unit was also compared with a reference on an audit recording; the measured error is stated."
ONLY_THIS = (
    "The results relate only to the item named above, in the condition it was in. This certificate may be reproduced "
    "in full only."
)
SIMULATED = (
    "SIMULATED: the recordings come from a simulated station. No instrument was used, no real unit was calibrated, and "
    "nothing is metrologically traceable."
)


@dataclass(frozen=True)
class Uncertainty:
    """Expanded uncertainty U (k = 2) of an estimate in one band of its range, mean over the unit's recording."""

    low: float
    high: float
    expanded: float


@dataclass(frozen=True, eq=False)
class Certificate:
    """What is certified, how it was found and what it rests on. Errors and ranges are in `reference_unit`.

    Args:
        identifier: unique over all certificates of a registry.
        made_on: UTC date of the calibration.
        recorded_on: UTC date the unit's recording came into the registry.
        issued_on: date of issue.
        low, high: range of the source's reference, within which the calibration holds.
        expected, expected_interval: predicted RMSE and its 95 % interval; None where none was made.
        limit, limit_origin: the agreed limit and where it comes from.
        acceptance: the largest error, with its guard band, that passes.
        conformity: pass, conditional pass, fail; empty where no statement may be made.
        measured: RMSE on an audit recording; None without one.
        reference: what the source was compared with; None where nobody said.
        bars: why the reference lets no unit pass; empty where it does.
        budget: uncertainty of an estimate at the source's RMS load; None for calibrations of older versions.
        bands: U by range of the estimate.
        output, mapped: (k,) output levels of this unit and the source output each stands for.
        estimated: the unit's own recording as estimated, with U (k = 2) around it.
    """

    identifier: str
    made_on: date
    recorded_on: date
    issued_on: date
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
    acceptance: float | None
    conformity: str
    verdict: str
    reasons: tuple[str, ...]
    before: float | None
    measured: float | None
    reference: Reference | None
    bars: tuple[str, ...]
    budget: Budget | None
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
    def is_simulated(self) -> bool:
        """Whether no real unit was calibrated."""
        return self.reference is not None and self.reference.is_simulated

    @property
    def is_traceable(self) -> bool:
        """Whether the results are traced to a certificate that held when the reference was used."""
        return self.reference is not None and self.reference.standing is Standing.VALID and not self.bars

    @property
    def method_name(self) -> str:
        """The method in a few words, as it was."""
        return METHODS.get(self.map_family, (self.map_family, ""))[0]

    @property
    def method(self) -> str:
        """The method as it was."""
        found = METHODS.get(self.map_family, ("", f"A map of the family {self.map_family} was found"))[1]
        return (
            "A time-delay network f (15 output samples to one estimate) was trained on the source unit against its "
            f"reference ({PAPER}). The unit's own output was recorded without a reference. {found}; the unit's "
            f"estimate is f of the mapped window. Deviations from the method: {self.laboratory.performance.deviations}."
        )

    @property
    def place(self) -> str:
        """Where the calibration was performed."""
        stated, address = self.laboratory.performance.place, self.laboratory.laboratory
        if stated != NOT_STATED:
            return stated
        parts = [part for part in (address.street, address.post_code, address.city) if part != NOT_STATED]
        return f"{self.laboratory.performance.at}: {', '.join(parts) or NOT_STATED}"

    @property
    def traceability(self) -> str:
        """What the results are traced to."""
        if self.is_simulated:
            return SIMULATED
        cell, chain = self.reference, f"Traced through source unit {self.source} of lot {self.lot}"
        if cell is None:
            named = self.laboratory.load_cell.certificate
            told = "" if named == NOT_STATED else f" (the laboratory names {named}; the verdict was made without it)"
            return (
                f"{chain} to a reference whose certificate nobody stated with the lot{told}: the results are not "
                "metrologically traceable, and no statement of conformity is made."
            )
        if not self.is_traceable:
            return f"Not metrologically traceable, and no statement of conformity: {'; '.join(self.bars)}."
        by = f" of {cell.laboratory}" if cell.laboratory else ""
        return (
            f"{chain} to instrument {cell.cell or NOT_STATED}, certificate {cell.certificate}{by}, which held when the "
            f"source was recorded on {cell.used_on}."
        )


def certificate_of(unit: CalibratedUnit) -> Certificate:
    """Gather the facts of a calibrated unit.

    Raises:
        InputError: the laboratory file cannot be used, or names another certificate than the lot does.
    """
    record, lot = unit.stored.record, unit.lot
    found = _at_two_sigma(estimate(unit.network, unit.calibration, unit.recording))
    forecast = unit.calibration.forecast
    limit = record.evidence.get("limit_rmse")
    output, mapped = _map_curve(unit)
    source = unit.shared.source.reference
    reference = record.reference
    bars = () if reference is None else reference.bars(float(source.max()))
    laboratory = read_laboratory(unit.options.laboratory)
    _check_cell(laboratory, reference)
    expanded = float(str(record.evidence.get("reference_expanded") or 0.0))
    return Certificate(
        identifier=f"softcal-{record.serial}-r{unit.stored.revision}-{record.map_sha256[:8]}",
        made_on=unit.stored.made_at.date(),
        recorded_on=unit.recorded_on,
        issued_on=unit.options.issued_on or laboratory.performance.issued_on or datetime.now(UTC).date(),
        laboratory=laboratory,
        serial=record.serial,
        revision=unit.stored.revision,
        lot=lot.id,
        sensor_model=lot.sensor_model,
        source=unit.shared.source.unlabelled.serial,
        quantity=lot.reference_quantity,
        output_unit=lot.output_unit,
        reference_unit=lot.reference_unit,
        sample_rate_Hz=lot.sample_rate_Hz,
        samples=len(unit.recording),
        low=float(source.min()),
        high=float(source.max()),
        expected=None if forecast is None else forecast.rmse,
        expected_interval=None if forecast is None else (forecast.lower, forecast.upper),
        limit=float(limit) if isinstance(limit, int | float) else None,
        limit_origin=str(record.evidence.get("limit_origin") or ""),
        acceptance=None if limit is None else float(np.sqrt(max(float(limit) ** 2 - expanded**2, 0.0))),
        conformity="" if reference is None or bars else Verdict(record.verdict).conformity,
        verdict=record.verdict,
        reasons=tuple(map(str, record.reasons)),
        before=record.before_rmse,
        measured=record.after_rmse,
        reference=reference,
        bars=tuple(map(str, bars)),
        budget=_budget(unit, float(np.sqrt(np.mean(source**2)))),
        map_family=record.family,
        hashes=(
            ("network", record.network_id),
            ("map", record.map_sha256),
            ("unit's recording", record.recording_sha256),
            ("source recording", unit.shared.source_sha256),
        ),
        bands=_bands(found, float(source.min()), float(source.max())),
        output=output,
        mapped=mapped,
        estimated=found,
        software=f"softcal {version('softcal')}",
    )


def _check_cell(laboratory: Laboratory, reference: Reference | None) -> None:
    """Refuse a certificate about another instrument than the verdict was made with."""
    named = laboratory.load_cell.certificate
    if reference is None or reference.is_simulated or named in (NOT_STATED, reference.certificate):
        return
    raise InputError(
        f"laboratory file: load cell certificate {named}, but the lot states {reference.certificate or 'none'}; "
        "correct the one that is wrong; no certificate was written"
    )


def _budget(unit: CalibratedUnit, load: float) -> Budget | None:
    record = unit.stored.record
    if record.after_rmse is not None:
        return measured_budget(record.after_rmse, record.reference, load)
    terms = {
        name.removeprefix("u_"): float(value)
        for name, value in record.evidence.items()
        if name.startswith("u_") and isinstance(value, int | float)
    }
    if record.predicted_rmse is None or "model" not in terms:
        return None
    return forecast_budget(terms, record.knowledge, record.predicted_rmse, record.reference, load)


def _at_two_sigma(found: Estimate) -> Estimate:
    """Return estimates with U (k = 2) around them in place of the 90 % interval."""
    share = COVERAGE / NORMAL_90
    lower = found.estimate - share * (found.estimate - found.lower)
    return replace(found, lower=lower, upper=found.estimate + share * (found.upper - found.estimate))


def _bands(found: Estimate, low: float, high: float) -> tuple[Uncertainty, ...]:
    """Mean U in equal bands of the reference's range; empty bands are left out."""
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
