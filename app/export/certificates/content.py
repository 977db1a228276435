"""The facts of one certificate, gathered once; `pdf.py` and `dcc.py` are two forms of them."""

from dataclasses import dataclass, replace
from datetime import UTC, date, datetime
from itertools import pairwise

import numpy as np

from softcal.app.export.calibrated_unit import CalibratedUnit
from softcal.app.export.certificates import statements
from softcal.app.export.laboratory import NOT_STATED, Laboratory
from softcal.core.errors import InputError
from softcal.core.lot import Lot, escape_serial
from softcal.core.maps.anchors import AnchoredMap
from softcal.core.messages.figures import decimals_of, find_decimals, format_value
from softcal.core.recording import Array
from softcal.core.unit.adjustments import Correction
from softcal.core.unit.budget import COVERAGE, Budget, Reference, Traceability, forecast_budget, measured_budget
from softcal.core.unit.estimate import Estimate, estimate
from softcal.core.unit.state import UnitState
from softcal.core.unit.uncertainty import NORMAL_90, ErrorForecast
from softcal.core.unit.verdict import Limit, Verdict
from softcal.core.windows import resting
from softcal.db.provenance import Provenance

BANDS = 4
"""The calibrated range is divided into this many equal bands."""


@dataclass(frozen=True)
class Uncertainty:
    """U_est (k = 2) of an estimate in one band of its range, mean over the unit's recording."""

    low: float
    high: float
    expanded: float


@dataclass(frozen=True, eq=False)
class Certificate:
    """Content of a certificate. Errors and ranges are in `lot.reference_unit`.

    Args:
        identifier: unique over all certificates of a registry.
        calculated_on: UTC date the calibration was calculated.
        in_registry_since, source_since: UTC dates recordings of unit and source came in.
        low, high: range that both the source's reference and the unit's own recording cover.
        forecast, measured: predicted RMSE, and that on an audit recording, if any.
        limit: largest error a unit may have, and where that comes from.
        is_sampled: whether audits of other units decided.
        is_trimmed: whether its map was trimmed after its audit.
        reference: what the source was compared with; None where nobody said.
        blocking_reasons: why the reference lets no unit pass; empty where it does.
        budget: at the source's RMS load; None after a trim.
        load_correction: adjustment of the map by known loads; empty without any.
        audit_correction: correction of the common bias of audited units, if any.
        audit_rows: how many rows of its audit have an estimate, and how many have none.
        revision_reason: why this revision was made, in the registry's words.
        bands: U_est by range; none where no estimate lies in the source's range.
        output, mapped: (k,) output levels of this unit and the source output of each.
        estimated: the unit's own recording as estimated, with U_est around it.
    """

    identifier: str
    calculated_on: date
    in_registry_since: date
    source_since: date | None
    issued_on: date
    laboratory: Laboratory
    serial: str
    revision: int
    lot: Lot
    source: str
    samples: int
    low: float
    high: float
    forecast: ErrorForecast | None
    limit: Limit | None
    verdict: str
    reasons: tuple[str, ...]
    before: float | None
    measured: ErrorForecast | None
    is_sampled: bool
    is_trimmed: bool
    reference: Reference | None
    blocking_reasons: tuple[str, ...]
    budget: Budget | None
    map_family: str
    load_correction: str
    revision_reason: str
    map_sha256: str
    provenance: Provenance
    bands: tuple[Uncertainty, ...]
    output: Array
    mapped: Array
    estimated: Estimate
    audit_correction: str = ""
    excluded_samples: int = 0
    audit_rows: str = ""

    @property
    def recording_summary(self) -> str:
        """Sentence on the number of samples used, and the number left out."""
        exclusions = f" (invalid samples left out: {self.excluded_samples})" if self.excluded_samples else ""
        return f"{self.samples} samples at {self.lot.sample_rate_Hz:g} Hz{exclusions}"

    @property
    def basis(self) -> str:
        """Whether the error was predicted or measured."""
        if self.is_trimmed:
            return statements.TRIMMED
        if self.measured is not None:
            return f"{statements.COMPARED} {self.audit_rows}".strip()
        return f"{statements.NOT_COMPARED} {statements.SAMPLED}" if self.is_sampled else statements.NOT_COMPARED

    @property
    def error(self) -> ErrorForecast | None:
        """E with E_lower and E_upper: the error that decides."""
        return self.measured or self.forecast

    def interval_of(self, error: ErrorForecast) -> tuple[float, float] | None:
        """Return the 95 % interval of an error; None if it is unknown."""
        has_interval = np.isfinite(error.upper) and not (self.is_sampled and error is self.forecast)
        return (error.lower, error.upper) if has_interval else None

    @property
    def decision_numbers(self) -> list[tuple[str, float | None, str]]:
        """The numbers of the decision rule: name with its symbol, value (None: not stated), and a note."""
        numbers: list[tuple[str, float | None, str]] = []
        if (error := self.error) is not None and np.isfinite(error.upper):
            numbers += [
                ("E: error", error.rmse, "the one that decides"),
                ("E_lower: lower end", error.lower, "of its interval"),
                ("E_upper: upper end", error.upper, "of its interval"),
            ]
        if (limit := self.limit) is not None:
            numbers += [
                ("TL: limit", limit.maximum_rmse, str(limit.origin)),
                ("U_ref: reference", limit.reference_expanded, "its expanded uncertainty, k = 2"),
                ("AL: acceptance limit", limit.acceptance_rmse, ""),
            ]
        return numbers

    @property
    def decimals(self) -> int:
        """Decimals of errors on paper: those of U with two digits, more where rounding would change the statement."""
        error, limit = self.error, self.limit
        if error is None or not np.isfinite(error.upper):
            return decimals_of(float("nan"))
        min_decimals = decimals_of(error.upper - error.rmse)
        if limit is None:
            return min_decimals
        compared = {"E": error.rmse, "E_upper": error.upper, "TL": limit.maximum_rmse, "AL": limit.acceptance_rmse}
        return find_decimals(compared, min_decimals, [("E_upper", "AL"), ("E", "TL")])

    @property
    def withholding_codes(self) -> tuple[str, ...]:
        """Codes of `WITHHOLDING_REASONS`: reasons for making no statement of conformity; empty with one."""
        conditions = {
            "simulated": self.is_simulated,
            "no_limit": self.limit is None or not self.limit.is_stated,
            "no_reference": self.reference is None,
            "reference": bool(self.blocking_reasons),
            "known_loads": self.is_load_corrected_only,
            "no_interval": self.error is None or not np.isfinite(self.error.upper),
            "retest": not Verdict(self.verdict).conformity,
        }
        return tuple(code for code, is_met in conditions.items() if is_met)

    @property
    def conformity(self) -> str:
        """Pass, conditional pass or fail; empty without a statement."""
        return "" if self.withholding_codes else Verdict(self.verdict).conformity

    @property
    def no_statement(self) -> str:
        """Sentence with the reason for making no statement of conformity; empty with one."""
        reasons = "; ".join(statements.WITHHOLDING_REASONS[code] for code in self.withholding_codes)
        return f"No statement of conformity is made: {reasons}." if reasons else ""

    @property
    def is_load_corrected_only(self) -> bool:
        """Whether known loads adjusted the map after the last audit."""
        return bool(self.load_correction) and (self.measured is None or self.is_trimmed)

    @property
    def is_simulated(self) -> bool:
        """Whether no real unit was calibrated."""
        return self.reference is not None and self.reference.is_simulated

    @property
    def is_traceable(self) -> bool:
        """Whether results are traceable to a certificate that was valid when the reference was used."""
        is_valid = self.reference is not None and self.reference.traceability is Traceability.VALID
        return is_valid and not self.blocking_reasons and not self.is_load_corrected_only

    @property
    def method_name(self) -> str:
        """Short name of the method of the calibration."""
        return statements.METHODS.get(self.map_family, (self.map_family, ""))[0]

    @property
    def method(self) -> str:
        fit = statements.METHODS.get(self.map_family, ("", f"A map of the family {self.map_family} was found"))[1]
        return (
            "A time-delay network f (15 output samples to one estimate) was trained on the source unit against its "
            f"reference ({statements.PAPER}). The unit's own output was recorded without a reference. {fit}; the "
            f"unit's estimate is f of the mapped window. Deviations from the method: {self.deviations}."
        )

    @property
    def deviations(self) -> str:
        """Deviations from the method, from the registry and from the laboratory."""
        other_deviations = self.laboratory.performance.deviations
        corrections = [text for text in (self.load_correction, self.audit_correction) if text]
        return "; ".join([*corrections, f"others: {other_deviations}"]) if corrections else other_deviations

    @property
    def location(self) -> str:
        """Place of the calibration, as stated."""
        performance = self.laboratory.performance
        if performance.place != NOT_STATED or performance.at == NOT_STATED:
            return performance.place
        address = {"laboratory": self.laboratory.laboratory, "customer": self.laboratory.customer}.get(performance.at)
        parts = () if address is None else (address.street, address.post_code, address.city)
        return f"{performance.at}: {', '.join(part for part in parts if part != NOT_STATED) or NOT_STATED}"

    @property
    def began_on(self) -> date:
        """First day of performance: as stated, else from the registry."""
        return self.laboratory.performance.began_on or min(self.in_registry_since, self.ended_on)

    @property
    def ended_on(self) -> date:
        """Last day of performance: as stated, else from the registry."""
        performance = self.laboratory.performance
        return performance.ended_on or max(self.calculated_on, performance.began_on or self.calculated_on)

    @property
    def performance_days(self) -> str:
        """Dates of performance: as stated, and from the registry."""
        performance = self.laboratory.performance
        return (
            f"first day: {performance.began_on or NOT_STATED}; last day: {performance.ended_on or NOT_STATED}; "
            f"recording in the registry since {self.in_registry_since}; calculated on {self.calculated_on}"
        )

    @property
    def provenance_rows(self) -> list[tuple[str, str]]:
        """Provenance of this revision, one row per entry, for people."""
        return [*self.provenance.rows, ("SHA-256 of the map", self.map_sha256)]

    @property
    def traceability(self) -> str:
        if self.is_simulated:
            return statements.SIMULATED
        cell, chain = self.reference, f"Traced through source unit {self.source} of lot {self.lot.id}"
        if cell is None:
            number = self.laboratory.load_cell.certificate
            remark = (
                "" if number == NOT_STATED else f" (the laboratory names {number}; the verdict was made without it)"
            )
            return (
                f"{chain} to a reference whose certificate nobody stated with the lot{remark}: the results are not "
                "metrologically traceable."
            )
        if not self.is_traceable:
            causes = self.blocking_reasons or (statements.WITHHOLDING_REASONS["known_loads"],)
            return f"Not metrologically traceable: {'; '.join(causes)}."
        by = f" of {cell.laboratory}" if cell.laboratory else ""
        day = (
            f"on {cell.used_on}, since when the source's recording is in the registry"
            if cell.used_on == self.source_since
            else f"when the source was recorded on {cell.used_on}"
        )
        return f"{chain} to instrument {cell.cell or NOT_STATED}, certificate {cell.certificate}{by}, which held {day}."


def build_certificate(unit: CalibratedUnit) -> Certificate:
    """Gather the facts (`InputError`: the laboratory names another instrument)."""
    state, lot = unit.state, unit.lot
    fit, scores = state.fit, state.scores
    # After a trim the budget of the map before says nothing of this one.
    is_trimmed = any(reason.code == "trimmed" for reason in state.blocking_reasons)
    with_90, share = estimate(unit.network, unit.state, unit.recording), COVERAGE / NORMAL_90
    # U_est (k = 2) in place of the 90 % interval.
    lower, upper = (with_90.estimate + share * (end - with_90.estimate) for end in (with_90.lower, with_90.upper))
    estimates = replace(with_90, lower=lower, upper=upper)
    # The map at steady outputs, over the range of the unit's recording.
    output = np.linspace(float(unit.recording.output.min()), float(unit.recording.output.max()), 60)
    source, reference, laboratory = unit.shared.source.reference, fit.reference, unit.laboratory
    _check_load_cell(laboratory, reference)
    # The part of the source's range that the unit's recording reaches; all where none.
    low, high = float(source.min()), float(source.max())
    inside = estimates.estimate[(estimates.estimate >= low) & (estimates.estimate <= high)]
    if len(inside):
        low, high = float(inside.min()), float(inside.max())
    audit_correction = ""
    if isinstance(state.line_behind, Correction):
        line, number = state.line_behind.line, state.line_behind.number
        audit_correction = (
            f"correction {number} of the lot, from {state.line_behind.audits} audited units: estimates less "
            f"{line.zero:+.4g} {lot.reference_unit}, divided by {line.gain:.4g}"
        )
    return Certificate(
        identifier=f"softcal-{escape_serial(unit.serial)}-r{unit.stored.revision}-{state.map_sha256[:8]}",
        calculated_on=unit.stored.made_at.date(),
        in_registry_since=unit.in_registry_since,
        source_since=unit.shared.source_since,
        issued_on=unit.options.issued_on or laboratory.performance.issued_on or datetime.now(UTC).date(),
        laboratory=laboratory,
        serial=unit.serial,
        revision=unit.stored.revision,
        lot=lot,
        source=unit.shared.source.unlabelled.serial,
        samples=len(unit.recording),
        excluded_samples=len(unit.recording.masked),
        low=low,
        high=high,
        forecast=state.forecast,
        limit=state.limit,
        verdict=unit.verdict,
        reasons=tuple(map(str, unit.reasons)),
        before=None if scores is None else scores.before.rmse,
        measured=None if scores is None else scores.after.interval,
        audit_rows=_describe_audit_rows(state),
        is_sampled=state.release_in_force is not None,
        is_trimmed=is_trimmed,
        reference=reference,
        blocking_reasons=() if reference is None else tuple(map(str, reference.blocking_reasons(float(source.max())))),
        budget=None if is_trimmed else _budget(state, float(np.sqrt(np.mean(source**2)))),
        map_family=fit.family,
        load_correction=_describe_load_correction(state, lot.output_unit),
        audit_correction=audit_correction,
        revision_reason=unit.stored.reason,
        map_sha256=state.map_sha256,
        provenance=unit.provenance,
        bands=_bands(estimates, low, high),
        output=output,
        mapped=unit.state.unit_map.apply(resting(output))[:, -1],
        estimated=estimates,
    )


def _check_load_cell(laboratory: Laboratory, reference: Reference | None) -> None:
    """Refuse a certificate about another load cell than that of the verdict."""
    if reference is None or reference.is_simulated:
        return
    load_cell = laboratory.load_cell
    # A lot may state a certificate and leave the serial to the laboratory.
    serials = ("serial", load_cell.serial, reference.cell or load_cell.serial)
    for label, message, other in (("certificate", load_cell.certificate, reference.certificate), serials):
        if message not in (NOT_STATED, other):
            raise InputError(
                f"laboratory file: load cell {label} {message}, but the lot states {other or 'none'}; correct the one "
                "that is wrong; no certificate was written"
            )


def _describe_audit_rows(state: UnitState) -> str:
    """Return the sentence on the number of rows of the measured error; empty without an audit."""
    if state.scores is None:
        return ""
    unscored = ", ".join(f"{flag} {count}" for flag, count in state.scores.unscored.items() if count)
    return f"Rows of the audit that have an estimate: {state.scores.after.rows}; without one: {unscored or 'none'}."


def _describe_load_correction(state: UnitState, unit: str) -> str:
    """Return the sentence on adjustments of the map by known loads; empty without any."""
    anchored = state.unit_map
    if not state.correspondence.is_anchored or not isinstance(anchored, AnchoredMap):
        return ""
    action = "trimmed" if state.trim_in_force else "set"
    return (
        f"the map was {action} by known loads: what it gave is multiplied by {anchored.gain:.4g} and moved by "
        f"{anchored.offset:+.4g} {unit}; what these loads are traced to is {NOT_STATED}"
    )


def _budget(state: UnitState, load: float) -> Budget | None:
    fit = state.fit
    if state.scores is not None:
        return measured_budget(state.scores.after.rmse, fit.reference, load)
    if "model" not in fit.budget:
        return None
    return forecast_budget(fit.budget, state.correspondence, state.predicted_rmse, fit.reference, load)


def band_range(band: Uncertainty) -> str:
    """Write the range of a band with as many decimals as its uncertainty."""
    return f"{format_value(band.low, band.expanded)} to {format_value(band.high, band.expanded)}"


def _bands(estimates: Estimate, low: float, high: float) -> tuple[Uncertainty, ...]:
    """Mean U_est in equal bands of a range; empty bands are left out."""
    half = (estimates.upper - estimates.lower) / 2
    return tuple(
        Uncertainty(start, end, float(half[inside].mean()))
        for start, end in pairwise(np.linspace(low, high, BANDS + 1).tolist())
        if (inside := (estimates.estimate >= start) & (estimates.estimate <= end)).any()
    )
