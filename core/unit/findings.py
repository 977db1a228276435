"""What the mapped windows of a unit tell about it: wrong programme, other sensor, reversed wiring, drift, creep."""

from collections.abc import Mapping

import numpy as np

from softcal.core.recording import Array, OutputRecording
from softcal.core.unit.forecast import REACH, MapEvidence, is_placed, map_variance, rest_rows
from softcal.core.unit.source_model import SourceModel
from softcal.core.unit.verdict import Finding

UNFAMILIAR_SHARE = 0.05
COVERED_SHARE = 0.75
ENOUGH_OVERLAP = 0.6
SPEED_FACTOR = 1.7
OVERLAP_GAIN = 0.14
"""Where before < after in simulated lots without positions, the map had raised the overlap by less than this."""

DRIFT_FACTOR = 2.0
"""Estimates at rest that move or scatter by this many times the source's own error are worth a word ..."""
LATE_S = 0.05
"""Units of one kind, started alike, follow each other within this; a third of a window is beyond it."""

MISREAD_FACTOR = 0.5
"""Estimates that stay off the source's loads for a second, at equal stage histories, by this many times its error."""

CREEP_FACTOR = 1.0
"""... scatter only where it exceeds the source's own scatter at rest by this many times that."""


def map_findings(model: SourceModel, target: OutputRecording, evidence: MapEvidence) -> tuple[Finding, ...]:
    """Say in words what the mapped windows show against the unit, if anything."""
    reversed_wiring = _reversed(model, target)
    checks = (
        reversed_wiring,
        _unfamiliar(model, evidence),
        # Turned upside down, the right programme looks wrong too.
        _other_use(evidence) if reversed_wiring is None else None,
        _uncovered(model, target, evidence),
        _misread(model, evidence) or _restless(model, target, evidence),
        _not_better(evidence),
    )
    return tuple(finding for finding in checks if finding is not None)


def opening_findings(evidence: Mapping[str, float | str]) -> tuple[Finding, ...]:
    """Return a finding where a unit follows the source late in an opening that both run from their own start.

    Args:
        evidence: of the chosen map (`ChosenMap.evidence`).
    """
    lag_s = float(evidence.get("lag_s", 0.0))
    if "shared_until_s" not in evidence or lag_s < LATE_S:
        return ()
    text = (
        f"output follows the source's {lag_s:.2f} s late in the opening both share: slow readout, or another clock; "
        "what happens faster than that is lost to the map"
    )
    return (Finding("late", text),)


def _unfamiliar(model: SourceModel, evidence: MapEvidence) -> Finding | None:
    share = float(np.mean(evidence.distance > model.interval.familiar_distance))
    if share <= UNFAMILIAR_SHARE:
        return None
    limit = model.interval.support.roughness_limit
    rough = float(np.mean(evidence.shape.roughness > limit))
    cause = (
        "its fast movements are unlike the source's: other sensor type, readout or rate"
        if rough > share / 2
        else ("other loads or speeds than the source has seen: wrong programme, or another sensor type")
    )
    text = f"unfamiliar: {share:.0%} of the mapped windows lie outside what the source has shown; {cause}"
    return Finding("unfamiliar", text, "fail" if share > 0.3 else "conditional")


def _uncovered(model: SourceModel, target: OutputRecording, evidence: MapEvidence) -> Finding | None:
    """Return a finding where the unit was pressed over too little of the source's range: by position where known."""
    source = model.source.unlabelled
    if target.stage_mm is not None and source.stage_mm is not None:
        what, unit, reach, whole = "pressed", "mm", _reach(target.stage_mm), _reach(source.stage_mm)
    else:
        what, unit = "loaded", model.network.reference_unit
        reach, whole = _reach(evidence.estimate), (model.interval.low, model.interval.high)
    share = (min(reach[1], whole[1]) - max(reach[0], whole[0])) / (whole[1] - whole[0])
    if share >= COVERED_SHARE:
        return None
    text = (
        f"profile not covered: the unit was {what} from {reach[0]:.3g} to {reach[1]:.3g} {unit}, {max(share, 0):.0%} "
        f"of the source's {whole[0]:.3g} to {whole[1]:.3g} {unit}; loads beyond are extrapolated"
    )
    return Finding("not covered", text)


def _reach(values: Array) -> tuple[float, float]:
    low, high = np.quantile(values, REACH)
    return float(low), float(high)


def _other_use(evidence: MapEvidence) -> Finding | None:
    """Return a finding where the unit's mix of loads and speeds is not the source's.

    Where the stage position is known the map does not rest on that mix; else nothing firm can be said. Units under one
    load at once ran one programme.
    """
    if "paired" in evidence.budget:
        return None
    if evidence.overlap >= ENOUGH_OVERLAP and 1 / SPEED_FACTOR <= evidence.speed <= SPEED_FACTOR:
        return None
    text = (
        f"wrong programme: the mix of loads and speeds overlaps the source's by {evidence.overlap:.0%}, fast movements "
        f"are {evidence.speed:.2g} x as fast; press the unit as the source was pressed, or it behaves otherwise"
    )
    return Finding("wrong programme", text, "conditional" if is_placed(evidence.budget) else "retest")


def _misread(model: SourceModel, evidence: MapEvidence) -> Finding | None:
    """Return a finding where the unit reads other loads than the source did at equal stage histories, for long."""
    slow = evidence.budget.get("slow", 0.0)
    if "paired" in evidence.budget or slow <= MISREAD_FACTOR * model.held_out_rmse:
        return None
    text = (
        f"reads other loads than the source at equal stage position and history, by {slow:.3g} "
        f"{model.network.reference_unit} for a second and longer: strong creep, lag, clipping or another sensor type"
    )
    return Finding("misread", text)


def _restless(model: SourceModel, target: OutputRecording, evidence: MapEvidence) -> Finding | None:
    """Return a finding where estimates at rest wander: a trend over the recording is drift, else slow recovery."""
    spread = evidence.budget["rest"]
    if spread < DRIFT_FACTOR * model.held_out_rmse:
        return None
    at_rest = rest_rows(model, evidence.estimate, evidence.shape)
    t_s = target.t_s[target.window_rows[evidence.rows]][at_rest]
    value = evidence.estimate[at_rest]
    trend = np.polyfit(t_s - t_s.mean(), value, 1)[0]
    explained = float(np.corrcoef(t_s, value)[0, 1] ** 2)
    unit = model.network.reference_unit
    if explained > 0.5:
        moved = float(trend * (t_s[-1] - t_s[0]))
        text = f"drift inside the recording: estimates at rest move by {moved:+.3g} {unit}; warm up, record again"
        return Finding("drift", text)
    # Slow holds at low loads count as rest too, and recordings hold more or fewer of them.
    if spread < CREEP_FACTOR * float(np.std(model.estimate[rest_rows(model, model.estimate, model.shape)])):
        return None
    text = f"unsteady at rest: estimates scatter by {spread:.3g} {unit} between presses: strong creep or a loose mount"
    return Finding("creep", text)


def _reversed(model: SourceModel, target: OutputRecording) -> Finding | None:
    """Return a finding where the output moves against the source's direction."""
    source = model.source.unlabelled
    if target.stage_mm is None or source.stage_mm is None:
        unit_sign, source_sign = _lean(target.output), _lean(source.output)
        surely = min(abs(unit_sign), abs(source_sign)) > 0.3
    else:
        unit_sign = float(np.corrcoef(target.output, target.stage_mm)[0, 1])
        source_sign = float(np.corrcoef(source.output, source.stage_mm)[0, 1])
        surely = min(abs(unit_sign), abs(source_sign)) > 0.3
    if not surely or unit_sign * source_sign > 0:
        return None
    text = "wrong wiring: the output moves against the source's direction; exchange the two leads or check the divider"
    return Finding("reversed", text, "fail")


def _lean(output: Array) -> float:
    """Return the robust skewness (Bowley 1901, with 5 % tails): positive where the unit rests low and peaks high."""
    low, middle, high = np.quantile(output, (0.02, 0.5, 0.98))
    return float((high + low - 2 * middle) / (high - low))


def _not_better(evidence: MapEvidence) -> Finding | None:
    """Return a finding where the map may be worse than doing nothing.

    It corrects less than it is uncertain by; or, where no position speaks for it, it makes the unit hardly more like
    the source than it was. A map that changes next to nothing does no harm either way.
    """
    doubt, correction = float(np.sqrt(map_variance(evidence.budget))), evidence.correction_rms
    model = evidence.budget["model"]
    is_blind = not is_placed(evidence.budget) and correction > 0.5 * model
    gained = evidence.overlap - evidence.unmapped_overlap
    if doubt > max(correction, 0.5 * model):
        why = f"is uncertain by {doubt:.3g}"
    elif is_blind and gained < OVERLAP_GAIN:
        why = f"brings the unit's use no nearer to the source's (overlap {gained:+.0%})"
    else:
        return None
    text = f"the map changes the estimates by {correction:.3g} but {why}: it may be worse than doing nothing"
    return Finding("not better", text)
