"""Departures that no effect of the catalogue covers, and a run that stands apart by its mistake.

A signal of the chain may have a gain or an offset that follows time or temperature, the load cell a
delay or a share of the position. They are no causes: where one wins, the report says `unknown`.

An effect acts in every run. Where one number, or the base parameters, of one run alone explain what
the twin leaves in all of them, that run was recorded otherwise: by a gain, a zero, or another unit.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np

from softcal.core.gap.case import Case, DataMistake, numbers, of_gain
from softcal.core.gap.fit import Fit, Tangent, fit
from softcal.core.gap.linear import dots, energy, gram
from softcal.core.recording import Array
from softcal.core.twin.effects import ChainStage, Effect, Flow, Hook, Memory, Parameter, Step
from softcal.core.twin.signals import low_pass
from softcal.core.words.reason import reason

if TYPE_CHECKING:
    from softcal.core.gap.search import Search

TIME, WARMTH, PLACE = attrgetter("t_s"), attrgetter("warmed_K"), attrgetter("stage_mm")
"""What of the flow a departure may follow."""


def changing(signal: str, follows: Callable[[Flow], Array | float], is_offset: bool = False) -> Step:
    """Return a step that raises a signal by its size, or such a share, times what it follows."""

    def step(flow: Flow, values: Sequence[float], _: Memory) -> None:
        now, change = getattr(flow, signal), values[0] * follows(flow)
        setattr(flow, signal, now + change if is_offset else now * (1.0 + change))

    return step


_offset = partial(changing, is_offset=True)


def _divider(flow: Flow, values: Sequence[float], _: Memory) -> None:
    # Only R/Rs enters the divider: a resistor that grows is a channel, dummy or not, that shrinks.
    flow.resistance_ohm = flow.resistance_ohm / (1.0 + values[0] * flow.warmed_K)


def _cell_lag(flow: Flow, values: Sequence[float], _: Memory) -> None:
    flow.reading_N = low_pass(flow.reading_N, flow.step_s, max(values[0], 1e-4), np.full(2, flow.reading_N[0]))


def _stranger(
    code: str, stage: ChainStage, hook: Hook, step: Step, unit: str, usual: float, is_signed: bool = True
) -> Effect:
    size = Parameter("size", unit, -30.0 * usual if is_signed else 0.0, 30.0 * usual, usual, neutral=0.0)
    return Effect(code, stage, hook, "", "no effect of the catalogue", (size,), step)


STRANGERS = (
    _stranger("gap.like.stiffness_in_time", "mechanics", Hook.FORCE, changing("force_N", TIME), "1/s", 1e-3),
    _stranger("gap.like.stiffness_when_warm", "mechanics", Hook.FORCE, changing("force_N", WARMTH), "1/K", 5e-3),
    _stranger("gap.like.sensitivity_in_time", "transduction", Hook.CHANNEL, changing("drive", TIME), "1/s", 1e-3),
    _stranger("gap.like.sensitivity_when_warm", "transduction", Hook.CHANNEL, changing("drive", WARMTH), "1/K", 5e-3),
    _stranger("gap.like.offset_in_time", "electronics", Hook.OUTPUT, _offset("output_V", TIME), "V/s", 2e-4),
    _stranger("gap.like.offset_when_warm", "electronics", Hook.OUTPUT, _offset("output_V", WARMTH), "V/K", 1e-3),
    _stranger("gap.like.cell_span_in_time", "load_cell", Hook.READING, changing("reading_N", TIME), "1/s", 1e-3),
    _stranger("gap.like.cell_span_when_warm", "load_cell", Hook.READING, changing("reading_N", WARMTH), "1/K", 5e-3),
    _stranger("gap.like.cell_zero_when_warm", "load_cell", Hook.READING, _offset("reading_N", WARMTH), "N/K", 0.01),
    _stranger("gap.like.cell_by_position", "load_cell", Hook.READING, _offset("reading_N", PLACE), "N/mm", 0.05),
    _stranger("gap.like.cell_late", "load_cell", Hook.READING, _cell_lag, "s", 0.1, is_signed=False),
)
"""Generic departures; the identifier is the reason that says what one is like."""

WARM_DIVIDER = _stranger("gap.like.divider_when_warm", "electronics", Hook.REFERENCE, _divider, "1/K", 1e-3)
"""Looks like a channel that follows the temperature, sign reversed, while the channel is read."""


def stranger_of(found: Fit) -> Effect:
    """Return the stranger of a hypothesis that has one."""
    return next(one for one in (*STRANGERS, WARM_DIVIDER) if one in found.effects)


@dataclass(frozen=True)
class _Oddity:
    """One way in which a run may differ: what, of which channel, by which effects of the twin."""

    what: str
    channel: str
    hooks: tuple[tuple[Hook, str, bool], ...]
    """(place of the chain, signal, whether it is multiplied instead of shifted) of every number."""


ODDITIES = (
    _Oddity("gain", "force", ((Hook.READING, "reading_N", True),)),
    _Oddity("zero", "force", ((Hook.READING, "reading_N", False),)),
    _Oddity("gain", "output", ((Hook.OUTPUT, "output_V", True),)),
    _Oddity("zero", "output", ((Hook.OUTPUT, "output_V", False),)),
    _Oddity("zero", "stage", ((Hook.MOTION, "pad_mm", False),)),
    _Oddity(
        "other_unit",
        "",
        (
            (Hook.FORCE, "force_N", True),
            (Hook.CHANNEL, "drive", True),
            (Hook.RESISTANCE, "resistance_ohm", True),
            (Hook.MOTION, "pad_mm", False),
        ),
    ),
)

_Fitted = tuple[Fit, int, _Oddity, float]
"""A fit with a mistake, its run, what it is, and the share it explains."""


def outlier_run(base: Fit) -> DataMistake | None:
    """Return the mistake of one run that explains what a fit leaves, None where none does."""
    config = base.problem.method.outlier
    outliers = [one for one in nearest(base, config.promised)[:1] if one[3] >= config.share]
    return _finding(*outliers[0]) if outliers else None


def outlier_run_beside(search: "Search") -> DataMistake | None:
    """Return the mistake of one run that, with one cause or none, explains more than all causes."""
    best, base, config = search.best, search.base, search.base.problem.method.outlier
    if len(best.ids) < 2 and search.model.is_clean(best):
        return None
    singles = sorted((f for ids, f in search.fits.items() if len(ids) == 1), key=lambda f: f.chi2)[: config.parents]
    tried = [(parent, found) for parent in (*singles, best) for found in nearest(parent, config.promised)[:1]]
    if not search.is_explained(best):
        # A cause as large as the mistake hides it from the base; beside it, it may explain the rest.
        for fitted, run, oddity, share in nearest(base, config.least_promised)[:2]:
            clean = [grown for grown in search.grown_from(fitted) if search.model.is_clean(grown)]
            tried += [(base, (grown, run, oddity, share)) for grown in clean]
    priced = []
    for parent, (fitted, run, oddity, share) in tried:
        # The mistake counts as one number more; it is of no catalogue and has no prior odds.
        price = parent.penalty if parent is not base or not singles else singles[0].penalty
        price += float(np.log(base.problem.count)) * len(oddity.hooks)
        if (share > config.share_beside or parent is base) and fitted.chi2 + price < best.bic - config.ahead:
            priced.append((fitted.chi2 + price, (fitted, run, oddity, share)))
    return _finding(*min(priced, key=lambda one: one[0])[1]) if priced else None


def nearest(base: Fit, promised_share: float) -> list[_Fitted]:
    """Return fitted mistakes of one run that promise this share of what is left, simplest first."""
    problem, is_clean = base.problem, base.problem.model.is_clean
    if is_clean(base):
        return []
    # Small zeros of single runs are taken off every fit; a mistake is looked for with none of them.
    base = fit(base.problem.bare, base.hypothesis, base.coordinates)
    runs = [k for k, run in enumerate(base.problem.case.runs) if run.kind == "press"]
    excess = base.chi2 - base.problem.count
    is_within_noise = excess < 4.0 * np.sqrt(2.0 * base.problem.count)
    if len(runs) < problem.method.mistake.fewest_runs or is_within_noise or is_clean(base):
        return []
    config, promised = problem.method.outlier, sorted(_promised(base, runs), key=lambda p: -p[0])
    found = []
    for gain, run, oddity in promised[:3]:
        if gain < max(promised_share * excess, 0.5 * promised[0][0]):
            continue
        effects = _effects(run, oddity, base)
        start = np.append(base.coordinates, np.zeros(len(effects)))
        fitted = fit(base.problem, base.hypothesis.adding(*effects), start, steps=30)
        found.append((fitted, run, oddity, (base.chi2 - fitted.chi2) / excess))

    def price(one: _Fitted) -> float:
        dearer = 0.0 if is_clean(one[0]) else config.dearer * excess
        return one[0].chi2 + len(one[2].hooks) * (config.each * float(np.log(base.problem.count)) + dearer)

    return sorted(found, key=price)


def _promised(base: Fit, runs: Sequence[int]) -> list[tuple[float, int, _Oddity]]:
    """Return to first order by how much each oddity of each run would lower χ² after a refit."""
    tangent, problem = Tangent(base), base.problem
    promised = []
    slopes = base.jacobian[base.hypothesis.of_base]
    for run in runs:
        inside = np.zeros(len(problem.measured))
        rows: dict[tuple[str, str], list[Array]] = {}
        for block in (b for b in problem.blocks if b.run == run):
            inside[block.place] = 1.0
            channel, here = block.channel.split("_")[0], np.zeros(len(problem.measured))
            here[block.place] = 1.0
            rows["zero", channel] = [problem.whitened(here)]
            rows["gain", channel] = [problem.whitened(here * base.predicted)]
        rows["other_unit", ""] = [row * inside for row in slopes]
        if problem.is_free[0]:
            rows["zero", "stage"] = [slopes[0] * inside]
        for oddity in ODDITIES:
            signatures = rows.get((oddity.what, oddity.channel))
            if signatures is None:
                continue
            gain, seen = 0.0, np.array([tangent.visible(s) for s in signatures if energy(s) > 0])
            if len(seen):
                pull = dots(seen, base.residual)
                coefficients, *_ = np.linalg.lstsq(gram(seen) + 1e-12 * np.eye(len(seen)), pull, rcond=1e-9)
                gain = float(coefficients @ pull)
            promised.append((gain, run, oddity))
    return promised


def _effects(run: int, oddity: _Oddity, base: Fit) -> list[Effect]:
    columns, effects = {"reading_N": "force_N", "output_V": "output_V", "pad_mm": "stage_mm"}, []
    # It acts in this run alone.
    step = partial(changing, follows=lambda flow: float(flow.run == run))
    for hook, signal, is_gain in oddity.hooks:
        span = 1.0 if is_gain else _span(base.problem.case, columns[signal])
        size = Parameter("size", "", -0.9 * span, 3.0 * span, 0.05 * span, neutral=0.0)
        effects.append(Effect(f"{signal} of run {run}", "", hook, "", "", (size,), step(signal, is_offset=not is_gain)))
    return effects


def _span(case: Case, column: str) -> float:
    parts = case.recorded(column)
    return float(np.ptp(np.concatenate(parts))) if parts else 1.0


def _finding(fitted: Fit, run: int, oddity: _Oddity, share: float) -> DataMistake | None:
    case, least = fitted.problem.case, fitted.problem.method.outlier.least
    number = (numbers(case)[run],)
    of_run = {e.id: values[0] for e, values in zip(fitted.effects, fitted.effect_values, strict=True)}
    sizes = [of_run[effect.id] for effect in _effects(run, oddity, fitted)]
    if oddity.what == "other_unit":
        stiffness, sensitivity, resistance, _ = sizes
        told = {"stiffness": stiffness, "resistance": resistance, "sensitivity": sensitivity, "share": min(share, 1.0)}
        evidence = reason("data.run.other_unit", **told)
        return DataMistake("other_unit", "", number, None, evidence, reason("data.repair.other_unit"))
    column = {"force": "force_N", "output": "output_V", "stage": "stage_mm"}[oddity.channel]
    span, size = _span(case, column), sizes[0]
    if oddity.what == "gain":
        ratio = 1.0 + size
        if abs(ratio - 1.0) < least:
            return None
        evidence = reason("data.run.gain", channel=oddity.channel, ratio=ratio, share=min(share, 1.0))
        return of_gain(oddity.channel, number, 1.0 / ratio, evidence)
    offset, unit = size if oddity.channel != "stage" else -size, column.split("_")[1]
    if abs(offset) < least * span:
        return None
    evidence = reason("data.run.zero", channel=oddity.channel, offset=offset, unit=unit, share=min(share, 1.0))
    repair = reason("data.repair.zero", channel=oddity.channel, offset=offset, unit=unit)
    return DataMistake("zero", oddity.channel, number, offset, evidence, repair)
