"""Choose the map of one unit by evidence that needs no label."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from softcal.core.errors import UnitRefused
from softcal.core.maps.affine_map import AFFINE, IDENTITY, TWO_POINT, fit_two_point
from softcal.core.maps.anchors import refine, source_curvature
from softcal.core.maps.catalogue import family
from softcal.core.maps.config import DEFAULT
from softcal.core.maps.crossing import CACHED, swings
from softcal.core.maps.interface import FitProblem, UnitMap
from softcal.core.maps.monotone import AVERAGED, MONOTONE
from softcal.core.maps.paired import STAGE_MATCHED, SYNCHRONOUS
from softcal.core.recording import Array, OutputRecording

_KIND = {SYNCHRONOUS: "paired", STAGE_MATCHED: "stage"}
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
    that both share, then matched distributions. Of these: quantiles where the units spend their time alike; rest and
    hardest presses alone where the unit swings like noise, or known loads show a straight source; else the mean of the
    two, by how well the hardest presses are known. The identity is taken where no difference from the source can be
    shown.

    Raises:
        UnitRefused: the recording allows no map; the message says why.
    """
    evidence: Mapping[str, float | str]
    forced = problem.config.family
    if forced != DEFAULT:
        candidates = {forced: family(forced).fit(problem)} | _fitted(problem, IDENTITY, TWO_POINT)
        # The others are fitted all the same: where they disagree the estimate is uncertain.
        name, evidence = forced, {"decision": f"{forced}, as configured"}
    else:
        # Pairs need what not every recording has; these need the output alone.
        candidates = _fitted(problem, IDENTITY, AFFINE, TWO_POINT, MONOTONE, AVERAGED)
        name, evidence = _decide(problem, candidates)
    chosen = candidates.pop(name)
    if problem.anchors is None:
        return ChosenMap(chosen, evidence, candidates)
    # Maps that might have been taken are held against the known loads as well.
    refined = refine(problem, chosen, problem.anchors, _KIND.get(name, ""))
    by_loads: dict[str, float | str] = {
        "anchor_gain": refined.unit_map.gain,
        "anchor_offset": refined.unit_map.offset,
        "anchor_misfit": refined.misfit,
        # Two loads know the gain better than matched levels do.
        "gain_error": refined.gain_error,
        "rest_error": refined.rest_error,
    }
    others = {
        other: unit_map if other == IDENTITY else _by_loads(problem, unit_map) for other, unit_map in candidates.items()
    }
    return ChosenMap(refined.unit_map, {**evidence, **by_loads}, others)


def fit_family(problem: FitProblem, name: str) -> UnitMap:
    """Fit one family and refine it by anchors where there are any: the map `choose_map` takes where it is configured.

    Raises:
        UnitRefused: the recording allows no such map.
    """
    return _by_loads(problem, family(name).fit(problem))


def _by_loads(problem: FitProblem, unit_map: UnitMap) -> UnitMap:
    if problem.anchors is None:
        return unit_map
    return refine(problem, unit_map, problem.anchors, _KIND.get(unit_map.family, "")).unit_map


def _fitted(problem: FitProblem, *names: str) -> dict[str, UnitMap]:
    fits = {}
    for name in names:
        try:
            fits[name] = family(name).fit(problem)
        except UnitRefused:
            continue
    return fits


def _decide(problem: FitProblem, candidates: dict[str, UnitMap]) -> tuple[str, dict[str, float | str]]:
    """Name the candidate to take and why; paired candidates are added where pairs are to be had."""
    if TWO_POINT not in candidates:
        # Raises the reason in words: the output makes no swing.
        fit_two_point(problem)
    synchrony = problem.synchrony
    is_opening = bool(np.isfinite(synchrony.until_s))
    evidence: dict[str, float | str] = {
        "rank_correlation": synchrony.rank_correlation,
        "synchrony_sigma": synchrony.sigma,
    }
    # In order of trust: the first that can be fitted is taken, since a known pair beats any matched distribution.
    for name, is_offered, cause in (
        (SYNCHRONOUS, synchrony.is_synchronous and not is_opening, "pressed by the source's load at the same time"),
        (STAGE_MATCHED, problem.target.stage_mm is not None, "windows paired at equal stage position and history"),
        (SYNCHRONOUS, synchrony.is_synchronous, "opened by the source's load at the same time: that part is paired"),
    ):
        paired = _fitted(problem, name) if is_offered else {}
        if paired:
            candidates |= paired
            if name == SYNCHRONOUS:
                # How far the clocks are apart, and where the common load ends if it does.
                evidence["lag_s"] = synchrony.lag_s
                if is_opening:
                    evidence["shared_until_s"] = synchrony.until_s
            return name, evidence | {"decision": cause}
    name, numbers = _without_pairs(problem, candidates)
    return name, evidence | numbers


def _without_pairs(problem: FitProblem, candidates: dict[str, UnitMap]) -> tuple[str, dict[str, float | str]]:
    config = problem.config.choice
    match = problem.ends
    target_rate, source_rate = (
        swings(recording, problem.config.crossing) / len(recording)
        for recording in (problem.target, problem.source.unlabelled)
    )
    # Noise that passes for presses shows as far more swings than the source has.
    rate = target_rate / max(source_rate, 1e-9)
    mapped = candidates[TWO_POINT].apply(problem.target.bridged.windows)
    # Over 20 levels: ten or forty tell programmes apart as well.
    dwell = dwell_distance(problem.source.unlabelled, mapped, 20)
    numbers: dict[str, float | str] = {
        "swing_rate_ratio": rate,
        "gain": match.gain,
        "gain_error": match.gain_error,
        "rest_error": match.rest_error,
        "dwell_distance": dwell,
    }
    if rate > config.unlike_rate:
        cause = "swings far more often than the source: only rest level and hardest presses are matched; abstain"
        return TWO_POINT, numbers | {"decision": cause}
    # Both gain and rest must be within two standard errors: a map that is not needed only adds its own error.
    is_same_gain = abs(np.log(match.gain)) < 2 * match.gain_error
    is_same_rest = abs(match.rest_shift) < 2 * match.rest_error
    # And the gain better known than a map errs, or a difference hides in its uncertainty.
    if match.gain_error < problem.config.curve.match_error and is_same_gain and is_same_rest:
        return IDENTITY, numbers | {"decision": "no difference from the source that the recording could show"}
    if dwell < config.same_programme:
        return MONOTONE, numbers | {"decision": "time is spent as in the source: sample quantiles matched"}
    loads = 0 if problem.anchors is None else len(problem.anchors.reference)
    if (
        loads > 1
        and (curvature := source_curvature(problem.source, problem.config))
        < problem.config.anchors.max_linear_curvature
    ):
        cause = "known loads give gain and level, and the source is straight between them: so is the unit, of its kind"
        return TWO_POINT, numbers | {"source_bend": curvature, "decision": cause}
    cause = (
        f"{dwell:.0%} of the time is spent at other loads, or the unit is bent otherwise: mean of sample quantiles and "
        f"of rest and hardest presses, whose gain is uncertain by {match.gain_error:.1%}"
    )
    return AVERAGED, numbers | {"decision": cause}


def dwell_distance(source: OutputRecording, mapped_target: Array, cells: int) -> float:
    """Return how differently two units spend their time: 0 alike, 1 never at one level in one direction.

    Total variation distance between the shares of time per level, rising or falling, of the source and of (m, taps)
    windows of the target after its map.
    """
    edges, source_share = _time_shares(source, cells)
    return float(np.abs(source_share - _occupancy(mapped_target, edges)).sum() / 2)


@lru_cache(maxsize=CACHED)
def _time_shares(source: OutputRecording, cells: int) -> tuple[Array, Array]:
    """Return the inner edges of the levels, and the share of time in each cell."""
    # Equal shares of the source per cell: each difference from them is then known equally well.
    windows = source.bridged.windows
    edges = np.quantile(windows[:, -1], np.linspace(0, 1, cells + 1)[1:-1])
    return edges, _occupancy(windows, edges)


def _occupancy(windows: Array, edges: Array) -> Array:
    # Loading and unloading pass a level at different loads (hysteresis): they are counted apart.
    rising = windows[:, -5:].mean(axis=1) > windows[:, :5].mean(axis=1)
    cell = 2 * np.searchsorted(edges, windows[:, -1]) + rising
    return np.asarray(np.bincount(cell, minlength=2 * (len(edges) + 1)) / len(cell))
