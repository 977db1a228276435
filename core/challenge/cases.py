"""A sealed case: a rig, its causes and runs, and the visibility of the causes in the noise."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.optimize import brentq

from softcal.core.challenge.equations import CATALOGUE, CATALOGUE_FORM, OTHER_FORMS, OUTSIDE, OUTSIDE_FORM
from softcal.core.challenge.protocols import PROTOCOLS, weights
from softcal.core.challenge.published_equations import PUBLISHED_FORMS, PUBLISHED_OUTSIDE
from softcal.core.challenge.recording_mistakes import Mistake, RunOnFile, other_unit, write_runs
from softcal.core.challenge.rig import (
    BLOCK_COMPLIANCE_MM_PER_N,
    DEAD_WEIGHTS,
    DUMMY_RESISTOR,
    PRESS,
    REST,
    RIGID_BLOCK,
    Cause,
    Equation,
    Measured,
    Path,
    Rack,
    Rig,
    record,
)
from softcal.core.recording import Array, Rng

EQUATIONS: Mapping[tuple[str, str], Equation] = {
    **{(effect, CATALOGUE_FORM): equation for effect, equation in CATALOGUE.items()},
    **OTHER_FORMS,
    **PUBLISHED_FORMS,
    **{(effect, OUTSIDE_FORM): equation for effect, equation in {**OUTSIDE, **PUBLISHED_OUTSIDE}.items()},
}
"""Every equation a sealed rig may hold, by (effect, form)."""

RESISTORS_ohm = (4.7, 10.0, 15.0)
"""Dummy resistors of the bench. Metadata print them: one made from R0 would tell what is drawn."""

SPECIAL = (RIGID_BLOCK, DUMMY_RESISTOR, DEAD_WEIGHTS)
TEMPERATURE_STEP = "temperature_step"
NOT_PROPOSED = ("kept_back", "lot_source", "lot_unit")
EXPERIMENTS = (*(name for name in PROTOCOLS if name not in NOT_PROPOSED), *SPECIAL, TEMPERATURE_STEP)
"""What may be asked of a sealed rig beyond the runs of its case."""


@dataclass(frozen=True)
class RunPlan:
    """Plan of one run: a protocol or an experiment, and the seed of its random numbers."""

    protocol: str
    seed: int


@dataclass(frozen=True, eq=False)
class SealedCase:
    """Content of the seal for one case.

    Args:
        line: the stratum it was drawn for.
        peak_N: force at full depth.
        depth_mm: stage position at which the base model reaches the peak force.
        withheld: columns taken out of every run.
        kept_back: a run of a protocol that is not among `plans`.
        mistake: what went wrong when the runs were written down (`recording_mistakes.Mistake` as text); empty
            for nothing. `measure` gives what was measured, `write_runs` what the files have.
        turns_between_samples: the stage turns between two samples, so the pad goes up to 50 µm beyond the recorded
            path; otherwise the pad sees the recorded path, as the written model has it.
        tare_N: reading of the load cell without load, in every run.
        seating: standard deviation from run to run of the logarithm of the unloaded resistance.
        seat_mm: standard deviation from run to run of where the surface is.
    """

    name: str
    line: str
    rig: Rig
    peak_N: float
    depth_mm: float
    causes: tuple[Cause, ...]
    plans: tuple[RunPlan, ...]
    kept_back: RunPlan
    withheld: tuple[str, ...] = ()
    turns_between_samples: bool = False
    mistake: str = ""
    tare_N: float = 0.0
    seating: float = 0.0
    seat_mm: float = 0.0

    @property
    def stages(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(EQUATIONS[cause.effect, cause.form].stage for cause in self.causes))

    def measure(self, plan: RunPlan) -> Measured:
        """Run one plan on the rig; the same plan always gives the same recording."""
        rng = np.random.default_rng([plan.seed, 1])
        kind = plan.protocol if plan.protocol in (*SPECIAL, REST) else PRESS
        path, known_force = self._path(plan)
        if not self.turns_between_samples:
            # The pad sees straight lines between the positions at the sampling instants.
            sample_s: Array = np.arange(int(path.duration_s * self.rig.sample_rate_Hz) + 1, dtype=np.float64)
            sample_s /= self.rig.sample_rate_Hz
            path = Path(path.name, sample_s, path.position_mm(sample_s))
        temperature = _temperature(np.random.default_rng([plan.seed, 2]), plan.protocol, path.duration_s)
        dummy_ohm = RESISTORS_ohm[plan.seed % len(RESISTORS_ohm)] if kind == DUMMY_RESISTOR else None
        warmer, lower = np.random.default_rng([plan.seed, 3]).normal(size=2)
        rig = replace(
            self.rig,
            r0_ohm=self.rig.r0_ohm * float(np.exp(self.seating * warmer)),
            u0_mm=self.rig.u0_mm + self.seat_mm * float(lower),
        )
        measured = record(rig, Rack(self.causes, EQUATIONS), path, temperature, rng, kind, dummy_ohm, known_force)
        if kind in (PRESS, REST) and self.tare_N:
            measured = measured.with_columns(force_N=measured.columns["force_N"] + self.tare_N)
        return replace(measured, columns={k: v for k, v in measured.columns.items() if k not in self.withheld})

    def write_runs(self, plans: Sequence[RunPlan]) -> list[RunOnFile]:
        """Return runs in the form of files, with the case's mistake; the case's own runs are first in `plans`."""
        runs, others = [self.measure(plan) for plan in plans], []
        if self.mistake and Mistake.from_text(self.mistake).what == "other_unit":
            unit = replace(self, rig=other_unit(self.rig, Mistake.from_text(self.mistake)))
            others = [unit.measure(plan) for plan in plans]
        return write_runs(self.rig, runs, others, self.mistake)

    def _path(self, plan: RunPlan) -> tuple[Path, Callable[[Array], Array] | None]:
        rng = np.random.default_rng([plan.seed, 0])
        if plan.protocol == DEAD_WEIGHTS:
            times, forces = weights(rng, self.peak_N)
            return _stand_still(plan.protocol, float(times[-1])), lambda t_s: np.asarray(np.interp(t_s, times, forces))
        if plan.protocol == DUMMY_RESISTOR:
            return _stand_still(plan.protocol, 60.0), None
        if plan.protocol == RIGID_BLOCK:
            # The block is pressed twice up to the peak force at 0.02 mm/s, 2 s at every turn.
            yielding = sum(cause.values.get("compliance_mm_per_N", 0.0) for cause in self.causes)
            play_mm = sum(cause.values.get("width_mm", 0.0) for cause in self.causes)
            start_mm = max(0.0, self.rig.u0_mm - 0.02)
            deep_mm = self.rig.u0_mm + play_mm + (BLOCK_COMPLIANCE_MM_PER_N + yielding) * self.peak_N
            positions_mm = np.repeat([start_mm, deep_mm, start_mm, deep_mm, start_mm], 2)
            travel_s = np.abs(np.diff(positions_mm)) / 0.02
            times = np.concatenate([[0.0], np.cumsum(np.where(travel_s > 0, travel_s, 2.0))])
            return Path("rigid block", times, positions_mm), None
        name = "mixed_ramps" if plan.protocol == TEMPERATURE_STEP else plan.protocol
        return PROTOCOLS[name](rng, self.depth_mm), None


def full_depth_mm(rig: Rig, peak_N: float) -> float:
    """Return the stage position at which the base model reaches a force."""

    def excess_N(mm: float) -> float:
        return float(rig.pad_force_N(np.array(mm))) - peak_N

    return rig.u0_mm + float(brentq(excess_N, 0.0, peak_N / rig.k1_N_mm, xtol=1e-14))


def _stand_still(name: str, duration_s: float) -> Path:
    return Path(name, np.array([0.0, duration_s]), np.zeros(2))


def _temperature(rng: Rng, protocol: str, duration_s: float) -> Callable[[Array], Array]:
    """Room temperature in °C: warming to a level, a hump, or a slow wander of 1.5–8 K."""
    start_C, swing_K, shape = rng.uniform(20.0, 27.0), rng.uniform(1.5, 8.0), rng.integers(3)
    if protocol == TEMPERATURE_STEP:
        return lambda t_s: start_C + np.where((t_s > duration_s / 3.0) & (t_s < 2.0 * duration_s / 3.0), 10.0, 0.0)
    if shape == 0:
        return lambda t_s: np.asarray(start_C + swing_K * (1.0 - np.exp(-t_s / (0.4 * duration_s))))
    if shape == 1:
        return lambda t_s: np.asarray(start_C + swing_K * np.sin(np.pi * t_s / duration_s) ** 2)
    turns = rng.uniform(0.7, 2.2)
    return lambda t_s: np.asarray(start_C + 0.5 * swing_K * np.sin(2.0 * np.pi * turns * t_s / duration_s))


_STEPS = {"u0_mm": 1e-3, "k1_N_mm": 1e-3, "k3_N_mm3": 1e-3, "r0_ohm": 1e-4, "kappa_per_N": 1e-4}


def distance_sigma(case: SealedCase) -> float:
    """Return the visibility in σ: the norm of the part of the signature that no base parameter can imitate.

    The clean signals with and without the causes are compared. The part that lies in the span of the base
    parameters' derivatives is taken out (first-order refit). 5 is about the least that can be seen.
    """
    if "stage_mm" in case.withheld:
        return _distance_without_stage(case)
    base = replace(case, causes=())
    gap = _noiseless_channels(case) - _noiseless_channels(base)
    slopes: list[Array] = []
    for name, step in _STEPS.items():
        size = step * max(abs(float(getattr(case.rig, name))), 0.01)
        moved = replace(base, rig=replace(case.rig, **{name: getattr(case.rig, name) + size}))
        slopes.append((_noiseless_channels(moved) - _noiseless_channels(base)) / size)
    if case.rig.coloured_V or case.rig.coloured_N:
        return _residual_in_coloured_noise(case, np.column_stack([gap, *slopes]))
    return _residual_norm(gap, np.column_stack(slopes))


def _residual_in_coloured_noise(case: SealedCase, columns: Array) -> float:
    """Return the visibility of the first column in coloured noise, projected off the other columns.

    Args:
        columns: (samples, 6) in units of the white noise, ordered as `_noiseless_channels` has them.
    """
    rig, at, products = case.rig, 0, np.zeros((columns.shape[1], columns.shape[1]))
    for plan in case.plans:
        measured = case.measure(plan).columns
        fade = np.exp(-measured["t_s"] / rig.coloured_s)
        ratios = [rig.coloured_V / rig.noise_floor_V]
        ratios += [rig.coloured_N / rig.noise_N] if "force_N" in measured else []
        for ratio in ratios:
            covariance = ratio**2 * fade
            covariance[0] += 1.0
            part = columns[at : at + len(fade)]
            products += part.T @ solve_toeplitz(covariance, part)
            at += len(fade)
    imitable = products[0, 1:] @ np.linalg.pinv(products[1:, 1:]) @ products[1:, 0]
    return float(np.sqrt(max(products[0, 0] - imitable, 0.0)))


def _noiseless_channels(case: SealedCase) -> Array:
    """Return all channels of all runs in units of their noise, without noise and rounding."""
    parts = []
    for columns in _noiseless_runs(case):
        parts.append(columns["output_V"] / case.rig.noise_floor_V)
        if "force_N" in columns:
            parts.append(columns["force_N"] / case.rig.noise_N)
    return np.concatenate(parts)


def _noiseless_runs(case: SealedCase) -> Iterator[Mapping[str, Array]]:
    silent = replace(case, rig=replace(case.rig.without_noise(), adc_bits=30))
    return (silent.measure(plan).columns for plan in case.plans)


def _distance_without_stage(case: SealedCase) -> float:
    rig = case.rig
    moved = [rig, *(replace(rig, **{name: getattr(rig, name) * 1.001}) for name in ("r0_ohm", "kappa_per_N"))]
    gaps, slopes = [], []
    for columns in _noiseless_runs(case):
        force_N = np.maximum(0.0, columns["force_N"])
        ohms = [one.r0_ohm / (1.0 - one.kappa_per_N * force_N) for one in moved]
        base_V, *volts = (rig.vref_V * ohm / (ohm + rig.r_series_ohm) for ohm in ohms)
        slope = np.gradient(base_V) / np.where(np.abs(np.gradient(force_N)) > 1e-9, np.gradient(force_N), np.inf)
        noise_V = np.hypot(rig.noise_floor_V, slope * rig.noise_N)
        gaps.append((columns["output_V"] - base_V) / noise_V)
        slopes.append(np.column_stack([(one_V - base_V) / noise_V for one_V in volts]))
    return _residual_norm(np.concatenate(gaps), np.concatenate(slopes))


def _residual_norm(gap: Array, slopes: Array) -> float:
    weights_, *_ = np.linalg.lstsq(slopes, gap, rcond=None)
    return float(np.linalg.norm(gap - slopes @ weights_))


SPREAD = {"u0_mm": 0.005, "k1_N_mm": 0.003, "k3_N_mm3": 0.003, "r0_ohm": 0.08, "kappa_per_N": 0.06}
"""Standard deviations from unit to unit: of the contact position in mm, of all else relative."""


@dataclass(frozen=True, eq=False)
class LotRun:
    """One recording of a lot: `source`, `units` or `audit`, and its unit."""

    folder: str
    serial: str
    measured: Measured


def press_lot(case: SealedCase, units: int) -> Iterator[LotRun]:
    """Press a source unit and target units, each with an audit, on the rig of a sealed case."""
    rng = np.random.default_rng([case.kept_back.seed, 40_009])
    for number in range(units + 1):
        unit, serial = draw_sister_unit(case, rng), f"R{number:02d}"
        seeds = [int(seed) for seed in rng.integers(2**31, size=2)]
        if number == 0:
            yield LotRun("source", serial, unit.measure(RunPlan("lot_source", seeds[0])))
        else:
            yield LotRun("units", serial, unit.measure(RunPlan("lot_unit", seeds[0])))
            yield LotRun("audit", serial, unit.measure(RunPlan("lot_unit", seeds[1])))


def draw_sister_unit(case: SealedCase, rng: Rng) -> SealedCase:
    """Return another unit of the same make on the same rig, with no channel withheld."""
    deviation = dict(zip(SPREAD, np.clip(rng.normal(size=len(SPREAD)), -2.0, 2.0).tolist(), strict=True))
    changed = {
        name: getattr(case.rig, name) + size * deviation[name] * (1.0 if name == "u0_mm" else getattr(case.rig, name))
        for name, size in SPREAD.items()
    }
    return replace(case, rig=replace(case.rig, **changed), withheld=())
