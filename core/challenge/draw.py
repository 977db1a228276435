"""Draw sealed cases: each line is a stratum with its own kind of rig, causes and runs."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from softcal.core.challenge.cases import RunPlan, SealedCase, full_depth_mm
from softcal.core.challenge.catalogue_equations import CATALOGUE, CATALOGUE_FORM
from softcal.core.challenge.mistakes import draw_mistake
from softcal.core.challenge.other_forms import OTHER_FORMS
from softcal.core.challenge.outside_equations import OUTSIDE, OUTSIDE_FORM
from softcal.core.challenge.published import PUBLISHED_FORMS, PUBLISHED_OUTSIDE, PUBLISHED_SIZES
from softcal.core.challenge.rig import Cause, Rig
from softcal.core.challenge.score import CASES_OF_FLOOR, FLOORS
from softcal.core.challenge.sizes import CATALOGUE_SIZES, OUTSIDE_SIZES, Draw, Scope

Rng = np.random.Generator

FOUR_RUNS = ("slow_ramps", "fast_ramps", "steps_with_holds", "random")
SEED_BITS = 128
"""Bits of every seed: nobody can try them all against a path, a noise or a printed resistance."""


def drawn_seed(rng: Rng) -> int:
    """Return a seed of `SEED_BITS` bits."""
    return int.from_bytes(rng.bytes(SEED_BITS // 8), "big")


def draw_rig(rng: Rng, adc_bits: int | None = None) -> tuple[Rig, float]:
    """Draw a plausible rig and its peak force: pads of 1–2.5 N/mm, a few ohms, 12 to 16 bits."""
    vref_V = float(rng.choice([3.3, 5.0]))
    peak_N = float(rng.uniform(5.0, 10.0))
    r0_ohm = float(rng.uniform(2.5, 8.0))
    rig = Rig(
        u0_mm=float(rng.uniform(0.15, 0.5)),
        k1_N_mm=float(rng.uniform(1.0, 2.5)),
        k3_N_mm3=float(rng.uniform(0.05, 0.25)),
        r0_ohm=r0_ohm,
        kappa_per_N=float(rng.uniform(0.35, 0.6) / peak_N),
        noise_V=float(rng.uniform(0.8e-3, 1.8e-3)),
        noise_N=float(rng.uniform(8e-3, 2e-2)),
        vref_V=vref_V,
        # The metadata have it as a data sheet prints it, with two digits.
        r_series_ohm=float(f"{r0_ohm * rng.uniform(1.2, 3.0):.1e}"),
        adc_bits=adc_bits or int(rng.choice([12, 14, 16])),
        sample_rate_Hz=float(rng.choice([50.0, 50.0, 50.0, 50.0, 40.0, 80.0])),
    )
    return rig, peak_N


def _coloured(rng: Rng, rig: Rig, scope: Scope) -> Rig:
    """Give output, force or both noise of 0.1–1 % of the range used that fades within 0.1–2 s."""
    channel = rng.choice(["output", "force", "both"])
    share, fading_s = (float(np.exp(rng.uniform(*np.log(ends)))) for ends in ((0.001, 0.01), (0.1, 2.0)))
    return replace(
        rig,
        coloured_V=share * scope.span_V if channel != "force" else 0.0,
        coloured_N=share * scope.peak_N if channel != "output" else 0.0,
        coloured_s=fading_s,
    )


Causes: TypeAlias = Callable[[Rng, Scope], tuple[Cause, ...]]


def _some(count: int = 1, scale: float = 1.0, stages: Sequence[str] | None = None) -> Causes:
    """Return what draws causes of the catalogue at this share of their usual size."""
    pool = [effect for effect, equation in CATALOGUE.items() if stages is None or equation.stage in stages]

    def draw(rng: Rng, scope: Scope) -> tuple[Cause, ...]:
        names = [str(name) for name in rng.choice(pool, count, replace=False)]
        return tuple(Cause(name, CATALOGUE_FORM, CATALOGUE_SIZES[name](rng, scope, scale)) for name in names)

    return draw


def _by(equations: Sequence[tuple[str, str]], sizes: Mapping[str, Draw]) -> Causes:
    """Return what draws one of (effect, form) at its usual size."""

    def draw(rng: Rng, scope: Scope) -> tuple[Cause, ...]:
        effect, form = equations[int(rng.integers(len(equations)))]
        return (Cause(effect, form, sizes[effect](rng, scope, 1.0)),)

    return draw


def _single_or_none(stages: Sequence[str] | None = None) -> Causes:
    single = _some(stages=stages)
    return lambda rng, scope: () if rng.random() < 0.2 else single(rng, scope)


def _perhaps_single(chance: float) -> Causes:
    single = _some()
    return lambda rng, scope: single(rng, scope) if rng.random() < chance else ()


_SEEN_WITHOUT_CELL = ("motion", "mechanics", "transduction", "electronics", "acquisition")
_SEEN_WITHOUT_STAGE = ("transduction", "electronics", "load_cell", "acquisition")

LINES: Mapping[str, Causes] = {
    "usual": _some(),
    "third": _some(scale=0.3),
    "tenth": _some(scale=0.1),
    "form": _by(list(OTHER_FORMS), CATALOGUE_SIZES),
    "pair": _some(2),
    "triple": _some(3),
    "none": lambda rng, scope: (),
    "outside": _by([(effect, OUTSIDE_FORM) for effect in OUTSIDE], OUTSIDE_SIZES),
    "one_run": _single_or_none(),
    "one_speed": _single_or_none(),
    "no_load_cell": _single_or_none(_SEEN_WITHOUT_CELL),
    "no_stage": _single_or_none(_SEEN_WITHOUT_STAGE),
    "ten_bit": _single_or_none(),
    "turning": _some(),
    "published_form": _by(list(PUBLISHED_FORMS), CATALOGUE_SIZES),
    "published_outside": _by([(effect, OUTSIDE_FORM) for effect in PUBLISHED_OUTSIDE], PUBLISHED_SIZES),
    "mistakes": _perhaps_single(0.3),
    **dict.fromkeys(("untared", "reseated", "coloured"), _perhaps_single(0.5)),
}
"""The strata: singles at a rig's usual size and at 0.3 and 0.1 of it, the same causes by other equations, pairs,
triples, none, effects outside the catalogue, poor recordings, singles on a stage that turns between samples, causes and
effects by published equations nobody wrote the solver for, mistakes in the recordings, a third of them beside an
effect, and what every rig has, half of it beside an effect: a cell that was not tared, a unit that sits anew in every
run, noise that is not white."""

_SHARES = {"usual": 6, "third": 4, "tenth": 4, "form": 4, "pair": 5, "triple": 2, "none": 5, "outside": 5}
"""The mix of a challenge; every poor line counts 1."""

_PROTOCOLS = {"one_run": ("one_rich_run",), "one_speed": ("one_speed_ramps", "one_speed_ramps")}
_WITHHELD = {"no_load_cell": ("force_N",), "no_stage": ("stage_mm",)}


def draw_case(seed: int, name: str, line: str) -> SealedCase:
    """Draw one case of a line; the same seed and line give the same case."""
    rng = np.random.default_rng([seed, list(LINES).index(line)])
    rig, peak_N = draw_rig(rng, adc_bits=10 if line == "ten_bit" else None)
    peak_ohm = rig.r0_ohm / (1.0 - rig.kappa_per_N * peak_N)
    rest_V = rig.vref_V * rig.r0_ohm / (rig.r0_ohm + rig.r_series_ohm)
    scope = Scope(rig, peak_N, rest_V, rig.vref_V * peak_ohm / (peak_ohm + rig.r_series_ohm))
    rig = _coloured(rng, rig, scope) if line == "coloured" else rig
    causes = LINES[line](rng, scope)
    plans = tuple(RunPlan(name_, drawn_seed(rng)) for name_ in _PROTOCOLS.get(line, FOUR_RUNS))
    needs_temperature = any("coefficient_per_K" in cause.values for cause in causes)
    unlogged = () if needs_temperature or rng.random() < 0.5 else ("temperature_C",)
    kept_back = RunPlan("kept_back", drawn_seed(rng))
    tare_N = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.005, 0.025)) * peak_N if line == "untared" else 0.0
    return SealedCase(
        name=name,
        line=line,
        rig=rig,
        peak_N=peak_N,
        depth_mm=full_depth_mm(rig, peak_N),
        causes=causes,
        plans=plans,
        kept_back=kept_back,
        withheld=(*_WITHHELD.get(line, ()), *unlogged),
        turns_between_samples=line == "turning",
        mistake=draw_mistake(rng, rig, peak_N, scope.span_V, len(plans)) if line == "mistakes" else "",
        tare_N=tare_N,
        seating=float(rng.uniform(0.002, 0.008)) if line == "reseated" else 0.0,
        seat_mm=float(rng.uniform(0.005, 0.03)) if line == "reseated" else 0.0,
    )


def draw_challenge(seed: int, count: int) -> list[SealedCase]:
    """Draw a challenge of mixed lines, shuffled, so that neither name nor place tells anything.

    The lines that have a floor come first: each has `CASES_OF_FLOOR` cases before any other line has one.
    """
    weights = np.array([_SHARES.get(line, 1) for line in LINES], dtype=np.float64)
    least = np.array([line in FLOORS for line in LINES]) * min(CASES_OF_FLOOR, count // len(FLOORS))
    quota = least + np.floor(weights / weights.sum() * (count - least.sum())).astype(int)
    rng = np.random.default_rng([seed, 10_007])
    rest = rng.choice(len(weights), count - int(quota.sum()), p=weights / weights.sum())
    lines = np.repeat(list(LINES), quota + np.bincount(rest, minlength=len(weights)))
    rng.shuffle(lines)
    width = max(3, len(str(count)))
    return [
        draw_case(drawn_seed(rng), f"case-{number:0{width}d}", str(line)) for number, line in enumerate(lines, start=1)
    ]
