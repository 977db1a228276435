"""Choose the map of one unit by evidence that needs no label."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from softcal.core.errors import UnitRefused
from softcal.core.maps.affine import IdentityFamily
from softcal.core.maps.anchors import Anchoring, firmness, refine, source_bend
from softcal.core.maps.catalogue import family
from softcal.core.maps.config import DEFAULT, CrossingConfig
from softcal.core.maps.crossing import averaging_length, level_path
from softcal.core.maps.interface import Anchors, FitProblem, UnitMap
from softcal.core.maps.label_shift import dwell_distance
from softcal.core.maps.synchrony import Synchrony
from softcal.core.recording import OutputRecording

_KIND = {"synchronous": "paired", "phase": "stage"}
"""How the loads behind a family are known; any other rests on distributions."""


@dataclass(frozen=True, eq=False)
class ChosenMap:
    """The map of one unit and why it was taken.

    Args:
        evidence: numbers and words the choice rests on; `decision` says it in one sentence.
        alternatives: other candidates by name; where they disagree with `unit_map` the estimate is uncertain.
    """

    unit_map: UnitMap
    evidence: Mapping[str, float | str]
    alternatives: Mapping[str, UnitMap]

    @property
    def family(self) -> str:
        return self.unit_map.family


def choose_map(problem: FitProblem) -> ChosenMap:
    """Fit the candidates, take the one the evidence supports, and refine it by anchors where there are any.

    Order of trust: pairs under one load at equal time, then pairs at equal stage position, then pairs of an opening
    that both share, then matched distributions. Of these the dwell-blind one is taken unless the units spend their time
    alike. The identity is taken where no difference from the source can be shown.

    Raises:
        UnitRefused: the recording allows no map; the message says why.
    """
    evidence: Mapping[str, float | str]
    forced = problem.config.family
    if forced != DEFAULT:
        candidates = {forced: family(forced).fit(problem)} | _fitted(problem, ("identity", "label_shift"))
        # The others are fitted all the same: where they disagree the estimate is uncertain.
        name, evidence = forced, {"decision": f"{forced}, as configured"}
    else:
        # Pairs need what not every recording has; these four need the output alone.
        candidates = _fitted(problem, ("identity", "affine", "label_shift", "monotone", "between"))
        name, evidence = _decide(problem, candidates)
    chosen = candidates.pop(name)
    if problem.anchors is None:
        return ChosenMap(chosen, evidence, candidates)
    return _anchored(problem, problem.anchors, ChosenMap(chosen, evidence, candidates))


def fit_family(problem: FitProblem, name: str) -> UnitMap:
    """Fit one family and refine it by anchors where there are any: the map `choose_map` takes where it is configured.

    Raises:
        UnitRefused: the recording allows no such map.
    """
    unit_map = family(name).fit(problem)
    if problem.anchors is None:
        return unit_map
    return _refined(problem, unit_map, problem.anchors).unit_map


def _refined(problem: FitProblem, unit_map: UnitMap, anchors: Anchors) -> Anchoring:
    return refine(problem, unit_map, anchors, firmness(_KIND.get(unit_map.family, ""), problem.config.anchors))


def _anchored(problem: FitProblem, anchors: Anchors, found: ChosenMap) -> ChosenMap:
    """Hold the map and those that might have been taken against the known loads."""
    refined = _refined(problem, found.unit_map, anchors)
    told: dict[str, float | str] = {
        "anchor_gain": refined.unit_map.gain,
        "anchor_offset": refined.unit_map.offset,
        "anchor_misfit": refined.misfit,
        # Two loads know the gain better than matched levels do.
        "gain_error": refined.gain_error,
        "rest_error": refined.rest_error,
    }
    others = {
        name: other if name == IdentityFamily.name else _refined(problem, other, anchors).unit_map
        for name, other in found.alternatives.items()
    }
    return ChosenMap(refined.unit_map, {**found.evidence, **told}, others)


def _fitted(problem: FitProblem, names: tuple[str, ...]) -> dict[str, UnitMap]:
    fits = {}
    for name in names:
        try:
            fits[name] = family(name).fit(problem)
        except UnitRefused:
            continue
    return fits


def _decide(problem: FitProblem, candidates: dict[str, UnitMap]) -> tuple[str, dict[str, float | str]]:
    """Name the candidate to take and why; paired candidates are added where pairs are to be had."""
    if "label_shift" not in candidates:
        # Raises the reason in words: the output makes no swing.
        family("label_shift").fit(problem)
    synchrony = problem.synchrony
    is_opening = bool(np.isfinite(synchrony.until_s))
    evidence: dict[str, float | str] = {
        "rank_correlation": synchrony.rank_correlation,
        "synchrony_sigma": synchrony.sigma,
    }
    # In order of trust: the first that can be fitted is taken, since a known pair beats any matched distribution.
    for name, is_offered, why in (
        ("synchronous", synchrony.is_synchronous and not is_opening, "pressed by the source's load at the same time"),
        ("phase", problem.target.stage_mm is not None, "windows paired at equal stage position and history"),
        ("synchronous", synchrony.is_synchronous, "opened by the source's load at the same time: that part is paired"),
    ):
        paired = _fitted(problem, (name,)) if is_offered else {}
        if paired:
            candidates |= paired
            if name == "synchronous":
                evidence |= _shared(synchrony)
            return name, evidence | {"decision": why}
    name, numbers = _without_pairs(problem, candidates)
    return name, evidence | numbers


def _shared(synchrony: Synchrony) -> dict[str, float | str]:
    """Say how far the clocks are apart, and where the common load ends if it does."""
    until_s = {"shared_until_s": synchrony.until_s} if np.isfinite(synchrony.until_s) else {}
    return {"lag_s": synchrony.lag_s, **until_s}


def _without_pairs(problem: FitProblem, candidates: dict[str, UnitMap]) -> tuple[str, dict[str, float | str]]:
    config = problem.config.choice
    match = problem.ends
    target_rate, source_rate = (
        _swing_rate(recording, problem.config.crossing) for recording in (problem.target, problem.source.unlabelled)
    )
    # Noise that passes for presses shows as far more swings than the source has.
    rate = target_rate / max(source_rate, 1e-9)
    mapped = candidates["label_shift"].apply(problem.target.windows)
    dwell = dwell_distance(problem.source.unlabelled, mapped, config.dwell_cells)
    numbers: dict[str, float | str] = {
        "swing_rate_ratio": rate,
        "gain": match.gain,
        "gain_error": match.gain_error,
        "rest_error": match.rest_error,
        "dwell_distance": dwell,
    }
    if rate > config.unlike_rate:
        why = "swings far more often than the source: only rest level and hardest presses are matched; abstain"
        return "label_shift", numbers | {"decision": why}
    # Both gain and rest must be indistinguishable: a map that is not needed only adds its own error.
    is_same_gain = abs(np.log(match.gain)) < config.clear * match.gain_error
    is_same_rest = abs(match.rest_shift) < config.clear * match.rest_error
    if match.gain_error < config.sharp and is_same_gain and is_same_rest:
        return "identity", numbers | {"decision": "no difference from the source that the recording could show"}
    if dwell < config.same_programme:
        return "monotone", numbers | {"decision": "time is spent as in the source: sample quantiles matched"}
    known = 0 if problem.anchors is None else len(problem.anchors.reference)
    if known > 1 and (bend := source_bend(problem.source, problem.config.anchors)) < problem.config.anchors.straight:
        why = "known loads give gain and level, and the source is straight between them: so is the unit, of its kind"
        return "label_shift", numbers | {"source_bend": bend, "decision": why}
    why = (
        f"{dwell:.0%} of the time is spent at other loads, or the unit is bent otherwise: half way between rest and "
        "hardest presses, and sample quantiles"
    )
    return "between", numbers | {"decision": why}


def _swing_rate(recording: OutputRecording, config: CrossingConfig) -> float:
    path = level_path(recording, averaging_length(recording, config), config)
    return 0.0 if path is None else path.swings / len(recording)
