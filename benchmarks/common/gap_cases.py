"""A sealed case for the diagnosis, and whether its twin shrinks the gap of another run as the report forecasts.

The twin goes through its file and is simulated along a path that no fit has seen. The recording, and the floor that the
true rig itself leaves, are the examiner's.
"""

import json
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from common.tables import print_table

from softcal.core.challenge.cases import RunPlan, SealedCase
from softcal.core.challenge.explained_fraction import residual_rms
from softcal.core.gap.case import Case, Run
from softcal.core.gap.diagnosis import Diagnosis
from softcal.core.gap.fault_location import explained_twin
from softcal.core.gap.twin import diagnose
from softcal.core.twin.parameters import ReadoutMetadata
from softcal.core.twin.simulate import Twin, simulate, twin_from_record, twin_record

MIN_GAP = 0.05
"""Below this, in units of the noise, the base leaves no gap on that run whose shrink could be told."""

CLOSE = 0.10
"""Realised counts as foretold within this."""


def as_case(sealed: SealedCase, plans: Sequence[RunPlan]) -> Case:
    """Return the recordings of a sealed case as the diagnosis takes them, rounded like their files."""
    rig = sealed.rig
    readout = ReadoutMetadata(rig.vref_V, rig.adc_bits, rig.r_series_ohm, rig.sample_rate_Hz)
    runs = []
    for number, run in enumerate(sealed.write_runs(plans), start=1):
        measured, run_readout = run.measured, replace(readout, sample_rate_Hz=run.sample_rate_Hz)
        columns = {name: np.round(values, 6) for name, values in measured.columns.items()}
        columns_kept = {"kind": measured.kind, "profile": measured.profile, "dummy_ohm": measured.dummy_ohm, **columns}
        runs.append(Run(name=f"runs/{number}", readout=run_readout, **columns_kept))  # type: ignore[arg-type]
    return Case(sealed.name, tuple(runs))


def realised_by(twin: Twin, base: Twin, sealed: SealedCase) -> float:
    """Return 1 − (after − floor)/(before − floor) on the run kept back, channels in units of their noise."""
    before = _gap(base, sealed)
    return float("nan") if before < MIN_GAP else 1.0 - _gap(twin, sealed) / before


def _gap(twin: Twin, sealed: SealedCase) -> float:
    measured = sealed.measure(sealed.kept_back)
    columns = measured.columns
    # The steps of the ADC are in the recording already; a second rounding would count as a gap.
    fine = replace(twin, metadata=replace(twin.metadata, adc_bits=32))
    predicted = simulate(fine, columns["t_s"], columns["stage_mm"], None, columns.get("temperature_C"))
    noise = (sealed.rig.noise_floor_V, sealed.rig.noise_N)
    noise_floors = residual_rms(sealed, measured, sealed.rig, sealed.causes)
    names, values = ("output_V", "force_N"), (predicted[1], predicted[0])
    errors = [float(np.sqrt(np.mean((columns[n] - v) ** 2))) / s for n, v, s in zip(names, values, noise, strict=True)]
    return sum(max(0.0, error - noise_floor) for error, noise_floor in zip(errors, noise_floors, strict=True))


def through_file(twin: Twin) -> Twin:
    """Return the twin as its file gives it back."""
    return twin_from_record(json.loads(json.dumps(twin_record(twin))), "file")


def print_twins(cases: Sequence[SealedCase]) -> None:
    """Print a row per case: the twin with its empirical terms, or with the forms of its causes."""
    far: list[tuple[float, float, bool]] = []
    rows = (_row(diagnose(as_case(sealed, sealed.plans)), sealed, far) for sealed in cases)
    print_table("hidden | verdict | twin | forecast, 90 % interval | realised", rows)
    hits, inside = sum(abs(f - r) <= CLOSE for f, r, _ in far), sum(is_in for *_, is_in in far)
    print(
        f"{len(far)} twins: realised within {CLOSE:.2f} of the forecast in {hits}, within its interval in {inside}.\n"
    )


def _row(diagnosis: Diagnosis, sealed: SealedCase, far: list[tuple[float, float, bool]]) -> tuple[str, ...]:
    hidden = " + ".join(f"{c.effect} ({c.form})" for c in sealed.causes)
    if diagnosis.verdict == "data":
        return hidden, "data", "none", "", ""
    forms = [f"{s.effect_id} ({s.form or 'catalogue'})" for s in explained_twin(diagnosis.best).effects]
    twin, shrink, what = explained_twin(diagnosis.best), diagnosis.explained_fraction, ", ".join(forms)
    if sealed.line == "outside":
        if diagnosis.residual is None:
            return hidden, diagnosis.verdict, "no empirical term", "", ""
        twin = explained_twin(diagnosis.residual.fit, [one.term for one in diagnosis.residual.terms])
        shrink = diagnosis.residual.explained_fraction
        what = "; ".join([*diagnosis.residual.other_causes, *(one.term.formula for one in diagnosis.residual.terms)])
    if not twin.effects and not twin.empirical:
        return hidden, diagnosis.verdict, "the base alone", "", ""
    realised = realised_by(through_file(twin), explained_twin(diagnosis.base), sealed)
    if np.isfinite(realised):
        far.append((shrink.predicted, realised, shrink.low <= realised <= shrink.high))
    forecast_text = f"{shrink.predicted:.2f} [{shrink.low:.2f}, {shrink.high:.2f}]"
    return hidden, diagnosis.verdict, what, forecast_text, f"{realised:.2f}"
