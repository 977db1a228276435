"""Generator of sealed cases: each line is a stratum with its own kind of rig, causes and runs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from softcal.core.challenge.cases import RunPlan, SealedCase, full_depth_mm
from softcal.core.challenge.equations import CATALOGUE, CATALOGUE_FORM, OTHER_FORMS, OUTSIDE, OUTSIDE_FORM
from softcal.core.challenge.protocols import log_uniform
from softcal.core.challenge.published_equations import PUBLISHED_FORMS, PUBLISHED_OUTSIDE
from softcal.core.challenge.recording_mistakes import draw_mistake
from softcal.core.challenge.rig import Cause, Rig
from softcal.core.challenge.score import MIN_CASES, MIN_SHARES
from softcal.core.recording import Rng

MAINS_Hz = (50.0, 60.0)


@dataclass(frozen=True)
class EffectScales:
    """Scales of effect sizes on one rig."""

    rig: Rig
    peak_N: float
    rest_V: float
    peak_V: float

    @property
    def span_V(self) -> float:
        return self.peak_V - self.rest_V


def near(rng: Rng, centre: float, factor: float = 1.6) -> float:
    """Draw log-uniformly between centre/factor and centre·factor."""
    return float(centre * factor ** rng.uniform(-1.0, 1.0))


def _signed(rng: Rng, centre: float) -> float:
    return float(rng.choice([-1.0, 1.0])) * near(rng, centre)


def _saturation(rng: Rng, scope: EffectScales, scale: float) -> dict[str, float]:
    """Return one rail or the other, so far inside the used range that 4–12 % of it are lost at scale 1."""
    clipped_V = scale * rng.uniform(0.04, 0.12) * scope.span_V
    if rng.random() < 0.25:
        return {"low_V": scope.rest_V + clipped_V, "high_V": scope.rig.vref_V}
    return {"low_V": 0.0, "high_V": scope.peak_V - clipped_V}


def alias_Hz(line_Hz: float, rate_Hz: float) -> float:
    """Return the frequency at which sampling aliases a line, in Hz."""
    return float(abs(line_Hz - rate_Hz * round(line_Hz / rate_Hz)))


def _hum_Hz(rng: Rng, rate_Hz: float) -> float:
    """Alias of 50 or 60 Hz mains, away from 0 and from half the rate, where no sine is left."""
    mains_Hz = [m for m in MAINS_Hz if 0.5 < alias_Hz(m, rate_Hz) < rate_Hz / 2.0 - 0.5]
    return alias_Hz(float(rng.choice(mains_Hz)) + rng.normal(0.0, 0.03), rate_Hz)


def _tone_Hz(rng: Rng, at: EffectScales) -> float:
    """A frequency from 1 Hz to 0.45 of the rate, 1.5 Hz from every alias of the mains."""
    rate_Hz = at.rig.sample_rate_Hz
    aliases = [alias_Hz(mains_Hz, rate_Hz) for mains_Hz in MAINS_Hz]
    while True:
        frequency_Hz = float(rng.uniform(1.0, 0.45 * rate_Hz))
        if all(abs(frequency_Hz - alias) > 1.5 for alias in aliases):
            return frequency_Hz


Draw = Callable[[Rng, EffectScales, float], dict[str, float]]

SIGNED = True


def _sized(name: str, centre: float, is_signed: bool = False, **shapes: tuple[float, float]) -> Draw:
    """Return what draws a size about its centre, and shapes about theirs within a factor."""

    def draw(rng: Rng, at: EffectScales, scale: float) -> dict[str, float]:
        size = scale * (_signed(rng, centre) if is_signed else near(rng, centre))
        return {name: size} | {shape: near(rng, *about) for shape, about in shapes.items()}

    return draw


SIZES: dict[str, Draw] = {
    "backlash": _sized("width_mm", 0.05),
    "contact_shift": _sized("shift_mm", 0.06, SIGNED, tau_s=(20.0, 1.6)),
    "frame_compliance": _sized("compliance_mm_per_N", 0.02),
    "misaligned_contact": _sized("length_mm", 0.25),
    "stress_relaxation": _sized("share", 0.08, tau_s=(5.0, 2.5)),
    "mechanical_hysteresis": _sized("size", 0.05, scale_mm=(0.3, 1.6)),
    "mullins_softening": _sized("size", 0.08, cycles=(2.0, 1.6)),
    "channel_creep": _sized("share", 0.08, tau_s=(5.0, 2.5)),
    "channel_hysteresis": _sized("size", 0.05, scale_N=(1.0, 1.6)),
    "channel_collapse": lambda rng, at, scale: {
        "size_per_N2": scale * near(rng, 0.03),
        "onset_N": at.peak_N * rng.uniform(0.45, 0.7),
    },
    "thermal_drift": _sized("coefficient_per_K", 1.2e-3, SIGNED),
    "ageing_drift": _sized("size", 6e-3, SIGNED, tau_s=(10.0, 2.5)),
    "intermittent_contact": lambda rng, at, scale: {
        "step_ohm": scale * at.rig.r0_ohm * near(rng, 0.06),
        "count": float(rng.integers(2, 5)),
        "mean_s": near(rng, 0.6),
    },
    "readout_lag": _sized("tau_s", 0.1),
    "wiring_resistance": lambda rng, at, scale: {"wire_ohm": scale * at.rig.r0_ohm * near(rng, 0.2)},
    "reference_drift": _sized("rate_per_s", 3e-4, SIGNED),
    "mains_hum": lambda rng, at, scale: {
        "amplitude_V": scale * near(rng, 4e-3),
        "frequency_Hz": _hum_Hz(rng, at.rig.sample_rate_Hz),
    },
    "adc_saturation": _saturation,
    "loadcell_saturation": lambda rng, at, scale: {
        "saturation_N": float(at.peak_N * near(rng, 2.6, 1.25) / np.sqrt(scale))
    },
    "loadcell_nonlinearity": lambda rng, at, scale: {
        "size": scale * _signed(rng, 0.05),
        "capacity_N": at.peak_N * rng.uniform(1.1, 1.6),
    },
    "loadcell_creep": _sized("share", 0.025, tau_s=(12.0, 1.6)),
    "loadcell_drift": _sized("rate_N_per_s", 2e-3, SIGNED),
    "clock_offset": _sized("delay_s", 0.05, SIGNED),
    "clock_skew": _sized("skew", 1e-3, SIGNED),
    "dropped_samples": lambda rng, at, scale: {"count": float(max(1, round(scale * rng.integers(5, 13))))},
    "slip": _sized("jump_mm", 0.08),
    "pitch_error": _sized("amplitude_mm", 0.015, pitch_mm=(0.7, 1.6)),
    "permanent_set": _sized("share", 0.02),
    "adhesion": _sized("pull_N", 0.2, reach_mm=(0.2, 1.6)),
    "guide_friction": _sized("friction_N", 0.15),
    "modulus_temperature": _sized("coefficient_per_K", 5e-3, SIGNED),
    "contact_growth": lambda rng, at, scale: {
        "growth": scale * near(rng, 0.35),
        "half_N": at.peak_N * rng.uniform(0.1, 0.3),
    },
    "sensitivity_ageing": _sized("rate_per_s", 1.5e-3, SIGNED),
    "divider_temperature": _sized("coefficient_per_K", 1e-3, SIGNED),
    "adc_inl": lambda rng, at, scale: {
        "amplitude_V": scale * near(rng, 6e-3),
        "period_V": at.span_V * rng.uniform(0.3, 0.6),
    },
    "spikes": _sized("height_V", 0.06, rate_per_s=(0.5, 1.6)),
    "cable_drag": _sized("drag_N_per_mm", 0.06),
    "inertia": _sized("mass_kg", 2.5),
    "cell_filter": _sized("tau_s", 0.12),
    "cell_hysteresis": _sized("size", 0.04, scale_N=(1.0, 1.6)),
    "cell_span_temperature": _sized("coefficient_per_K", 4e-3, SIGNED),
    "jitter": _sized("spread_s", 6e-3),
    "screw_growth": _sized("growth", 0.02, tau_s=(60.0, 1.6)),
    "rate_stiffening": _sized("size", 0.05, speed_mm_s=(2.0, 1.6)),
    "film_contact": lambda rng, at, scale: {
        "film_ohm": scale * at.rig.r0_ohm * near(rng, 0.08),
        "load_N": near(rng, 0.3),
    },
    "stray_tone": lambda rng, at, scale: {"amplitude_V": scale * near(rng, 4e-3), "frequency_Hz": _tone_Hz(rng, at)},
    "cell_ringing": lambda rng, at, scale: {"frequency_Hz": near(rng, 5.0) / scale, "damping": near(rng, 0.08)},
}
"""How large an effect usually is on a rig, times a scale: magnitudes from the literature."""

FOUR_RUNS = ("slow_ramps", "fast_ramps", "steps_with_holds", "random")
SEED_BITS = 128
"""Bits of every seed: nobody can try them all against a path, a noise or a printed resistance."""


def draw_seed(rng: Rng) -> int:
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


def _add_coloured_noise(rng: Rng, rig: Rig, scope: EffectScales) -> Rig:
    """Add coloured noise to output, force or both: 0.1–1 % of the used range, correlation time 0.1–2 s."""
    channel = rng.choice(["output", "force", "both"])
    share, correlation_time_s = log_uniform(rng, 0.001, 0.01), log_uniform(rng, 0.1, 2.0)
    return replace(
        rig,
        coloured_V=share * scope.span_V if channel != "force" else 0.0,
        coloured_N=share * scope.peak_N if channel != "output" else 0.0,
        coloured_s=correlation_time_s,
    )


Causes: TypeAlias = Callable[[Rng, EffectScales], tuple[Cause, ...]]


def _some(count: int = 1, scale: float = 1.0, stages: Sequence[str] | None = None) -> Causes:
    """Return what draws causes of the catalogue at this share of their usual size."""
    pool = [effect for effect, equation in CATALOGUE.items() if stages is None or equation.stage in stages]

    def draw(rng: Rng, scope: EffectScales) -> tuple[Cause, ...]:
        names = [str(name) for name in rng.choice(pool, count, replace=False)]
        return tuple(Cause(name, CATALOGUE_FORM, SIZES[name](rng, scope, scale)) for name in names)

    return draw


def _by(equations: Sequence[tuple[str, str]]) -> Causes:

    def draw(rng: Rng, scope: EffectScales) -> tuple[Cause, ...]:
        effect, form = equations[int(rng.integers(len(equations)))]
        return (Cause(effect, form, SIZES[effect](rng, scope, 1.0)),)

    return draw


def _single_within(low: float, high: float, stages: Sequence[str] | None = None) -> Causes:
    """Return what draws one cause where a number from 0 to 1 falls within these, else none."""
    single = _some(stages=stages)
    return lambda rng, scope: single(rng, scope) if low <= rng.random() < high else ()


_STAGES_WITHOUT_CELL = ("motion", "mechanics", "transduction", "electronics", "acquisition")
_STAGES_WITHOUT_STAGE = ("transduction", "electronics", "load_cell", "acquisition")

LINES: dict[str, Causes] = {
    "usual": _some(),
    "third": _some(scale=0.3),
    "tenth": _some(scale=0.1),
    "form": _by(list(OTHER_FORMS)),
    "pair": _some(2),
    "triple": _some(3),
    "none": lambda rng, scope: (),
    "outside": _by([(effect, OUTSIDE_FORM) for effect in OUTSIDE]),
    "one_run": _single_within(0.2, 1.0),
    "one_speed": _single_within(0.2, 1.0),
    "no_load_cell": _single_within(0.2, 1.0, _STAGES_WITHOUT_CELL),
    "no_stage": _single_within(0.2, 1.0, _STAGES_WITHOUT_STAGE),
    "ten_bit": _single_within(0.2, 1.0),
    "turning": _some(),
    "published_form": _by(list(PUBLISHED_FORMS)),
    "published_outside": _by([(effect, OUTSIDE_FORM) for effect in PUBLISHED_OUTSIDE]),
    "mistakes": _single_within(0.0, 0.3),
    **dict.fromkeys(("untared", "reseated", "coloured"), _single_within(0.0, 0.5)),
}
"""The strata: singles at a rig's usual size and at 0.3 and 0.1 of it, the same causes by other
equations, pairs, triples, none, effects outside the catalogue, poor recordings, singles on a stage
that turns between samples, causes and effects by published equations nobody wrote the solver for,
mistakes in the recordings, a third of them beside an effect, and what every rig has, half of it
beside an effect: a cell that was not tared, a unit that sits anew in every run, noise that is not
white."""

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
    scope = EffectScales(rig, peak_N, rest_V, rig.vref_V * peak_ohm / (peak_ohm + rig.r_series_ohm))
    rig = _add_coloured_noise(rng, rig, scope) if line == "coloured" else rig
    causes = LINES[line](rng, scope)
    plans = tuple(RunPlan(name_, draw_seed(rng)) for name_ in _PROTOCOLS.get(line, FOUR_RUNS))
    needs_temperature = any("coefficient_per_K" in cause.values for cause in causes)
    unlogged = () if needs_temperature or rng.random() < 0.5 else ("temperature_C",)
    kept_back = RunPlan("kept_back", draw_seed(rng))
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
    """Draw a challenge of mixed lines, shuffled, so that name and order carry no information.

    Lines with a floor come first: each has `MIN_CASES` cases before any other has one.
    """
    weights = np.array([_SHARES.get(line, 1) for line in LINES], dtype=np.float64)
    min_counts = np.array([line in MIN_SHARES for line in LINES]) * min(MIN_CASES, count // len(MIN_SHARES))
    quota = min_counts + np.floor(weights / weights.sum() * (count - min_counts.sum())).astype(int)
    rng = np.random.default_rng([seed, 10_007])
    rest = rng.choice(len(weights), count - int(quota.sum()), p=weights / weights.sum())
    lines = np.repeat(list(LINES), quota + np.bincount(rest, minlength=len(weights)))
    rng.shuffle(lines)
    width = max(3, len(str(count)))
    return [
        draw_case(draw_seed(rng), f"case-{number:0{width}d}", str(line)) for number, line in enumerate(lines, start=1)
    ]
