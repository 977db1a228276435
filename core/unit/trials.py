"""Maps that a unit might have had, and maps fitted without a part of its recording: what its own map is tried by."""

from dataclasses import replace

import numpy as np

from softcal.core.errors import UnitRefused
from softcal.core.maps.affine_map import IDENTITY, LABEL_SHIFT
from softcal.core.maps.choose import ChosenMap, fit_family
from softcal.core.maps.interface import FitProblem, UnitMap
from softcal.core.maps.monotone import BETWEEN
from softcal.core.maps.paired import PHASE, SYNCHRONOUS, fit_pairs
from softcal.core.maps.synchrony import paired_rows
from softcal.core.recording import OutputRecording
from softcal.core.unit.evidence import OtherMaps, Trial
from softcal.core.unit.method import Method
from softcal.core.windows import TAPS


def other_maps(fit: FitProblem, chosen: ChosenMap, method: Method, floor: float) -> OtherMaps:
    """Return what the chosen map is tried by; `floor` is the RMS error of the reference beside paired windows."""
    trials = _trials(fit, chosen, method.forecast.opening_parts, floor) if chosen.family == SYNCHRONOUS else []
    # Where the stage position or a common load is known, that tells more than leaving shares out.
    is_measured = bool(trials) or chosen.family == PHASE
    return OtherMaps(
        alternatives=[other for name, other in chosen.alternatives.items() if name != IDENTITY],
        resampled=[] if is_measured else _refitted(fit, chosen, method),
        trials=trials,
        gain_error=_gain_error(chosen, method),
        straight=chosen.alternatives.get(LABEL_SHIFT) if chosen.family == BETWEEN else None,
    )


def _gain_error(chosen: ChosenMap, method: Method) -> float:
    """Return the standard error of log gain; a gain far from the source's is a doubt unless loads were given."""
    error, gain = float(chosen.evidence.get("gain_error", 0.0)), float(chosen.evidence.get("gain", 1.0))
    far = abs(float(np.log(gain)))
    is_doubtful = "anchor_gain" not in chosen.evidence and far > np.log(method.findings.said_stretch)
    return float(np.hypot(error, far)) if is_doubtful else error


def _trials(fit: FitProblem, chosen: ChosenMap, parts: int, floor: float) -> list[Trial]:
    """Return maps with the windows under one load at once to judge them by.

    An opening holds few presses, which the map has been bent to: there, each map has not seen the windows it is
    judged by.
    """
    source_rows, target_rows = paired_rows(fit.source.unlabelled, fit.target, fit.synchrony, fit.config.synchrony)
    if not np.isfinite(fit.synchrony.until_s):
        return [Trial(chosen.unit_map, fit.source, source_rows, target_rows, floor)]
    part = np.arange(len(target_rows)) * parts // len(target_rows)
    trials = []
    for held in (part == k for k in range(parts)):
        unit_map = fit_pairs(fit, source_rows[~held], target_rows[~held], SYNCHRONOUS)
        trials.append(Trial(unit_map, fit.source, source_rows[held], target_rows[held], floor))
    return trials


def _refitted(fit: FitProblem, chosen: ChosenMap, method: Method) -> list[UnitMap]:
    """Fit the chosen family again with one share of the recording left out at a time."""
    config, refits = method.forecast, []
    for part in range(config.parts):
        target = _without_share(fit.target, part, config.parts, config.stretches)
        try:
            refits.append(fit_family(replace(fit, target=target), chosen.family))
        except UnitRefused:
            continue
    return refits


def _without_share(target: OutputRecording, part: int, parts: int, stretches: int) -> OutputRecording:
    """Leave out every parts-th of many stretches, so that what is left still covers the whole programme."""
    length = max(len(target) // (parts * stretches), TAPS)
    keep = (np.arange(len(target)) // length) % parts != part
    stage_mm = None if target.stage_mm is None else target.stage_mm[keep]
    return replace(target, t_s=target.t_s[keep], output=target.output[keep], stage_mm=stage_mm)
