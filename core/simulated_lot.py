"""Simulated lots on the twin: good units, planted bad ones, shifted loads, with the truth."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from zlib import crc32

import numpy as np

from softcal.core.errors import InputError
from softcal.core.profiles import Profile, ramps, random_presses, source_profile, unit_profile
from softcal.core.recording import LabelledRecording, OutputRecording, Rng
from softcal.core.twin.parameters import BaseParameters
from softcal.core.twin.simulate import EffectSetting, Twin, simulate

GOOD = "good"
DEPTH_MM = 3.5
DAY = 86_400
"""Sets the draw of a day apart from all other draws of a lot."""
GOLDEN = 86_401
"""The same for the golden run."""


@dataclass(frozen=True)
class LotSpread:
    """Standard deviations from unit to unit: of the contact in mm, relative for all else.

    The defaults keep every unit well below the collapse of its channel (κ·F < 0.75 at 3.5 mm) and give responses
    that differ by tens of per cent, as the printed sensors of Kim and others 2020 do.
    """

    u0_mm: float = 0.05
    k1: float = 0.05
    k3: float = 0.05
    r0: float = 0.08
    kappa: float = 0.06
    noise: float = 0.15


@dataclass(frozen=True)
class UnitKind:
    """What is special about units of a lot: the unit, its wiring, how it is pressed."""

    name: str
    twin: Callable[[Rng, Twin], Twin] = lambda rng, twin: twin
    wired: Callable[[LabelledRecording], LabelledRecording] = lambda recording: recording
    profile: Callable[[Rng], Profile] | None = None


class SteadyLine:
    """What the line does to the units' recordings and not to their audits: here nothing."""

    def press_unit(self, rng: Rng, twin: Twin) -> Twin:
        """Return the unit as the press of the line meets it."""
        return twin

    def day(self, source: LabelledRecording, rng: Rng) -> Callable[[OutputRecording], OutputRecording]:
        """Return how the readout shows a recording on the units' day; source and audits have another."""
        return lambda recording: recording


@dataclass(frozen=True)
class LotDesign:
    """What kind of lot to simulate.

    Args:
        shift: how the units' loads differ from the source's, a name of `PROGRAMMES`.
        spread: how the units differ. What they differ by in stiffness and contact position changes
            the load at equal travel, which no unlabelled recording shows; the default takes pads
            from one mould, all else by tens of per cent.
        twin: the nominal unit and its effects, of a diagnosis for example; None draws them.
    """

    good: int = 6
    bad: Mapping[UnitKind, int] | None = None
    shift: str = "none"
    source_s: float = 170.0
    unit_s: float = 60.0
    audit_s: float = 120.0
    has_stage: bool = False
    spread: LotSpread = LotSpread(u0_mm=0.005, k1=0.003, k3=0.003)
    twin: Twin | None = None
    line: SteadyLine = SteadyLine()

    def __post_init__(self) -> None:
        if self.shift not in PROGRAMMES:
            raise InputError(f"shift {self.shift!r} is unknown; known: {', '.join(PROGRAMMES)}")


@dataclass(frozen=True, eq=False)
class SimulatedUnit:
    """One unit of a simulated lot; its audit, under the source's programme, is the truth."""

    kind: str
    recording: OutputRecording
    audit: LabelledRecording

    @property
    def serial(self) -> str:
        return self.recording.serial


@dataclass(frozen=True, eq=False)
class SimulatedLot:
    """A source unit, the units made with it, and the source once more in the units' sitting."""

    source: LabelledRecording
    units: tuple[SimulatedUnit, ...]
    golden: LabelledRecording


def simulate_lot(seed: int, design: LotDesign | None = None) -> SimulatedLot:
    """Simulate a lot; equal seed and design give equal recordings.

    Every lot has its own nominal unit and its own mild creep, hysteresis and readout lag, which its
    units share up to a fifth of their size.
    """
    design, rng = design or LotDesign(), np.random.default_rng(seed)
    kinds = [UnitKind(GOOD)] * design.good + [kind for kind, count in (design.bad or {}).items() for _ in range(count)]
    twins = draw_twins(rng, len(kinds) + 1, design.spread, design.twin)
    programme = PROGRAMMES[design.shift]

    def audited(rng: Rng, twin: Twin, duration_s: float, serial: str) -> LabelledRecording:
        profile = source_profile(rng, duration_s, DEPTH_MM)
        return _record(rng, twin, profile, serial, design.has_stage)

    source = audited(rng, twins[0], design.source_s, "S0")
    units = []
    for k, (twin, kind) in enumerate(zip(twins[1:], kinds, strict=True), start=1):
        unit_twin, serial = kind.twin(rng, twin), f"U{k:03d}"
        profile = programme(rng, design.unit_s)
        profile = kind.profile(rng) if kind.profile else profile
        unit_pressed = design.line.press_unit(rng, unit_twin)
        recording = _record(rng, unit_pressed, profile, serial, design.has_stage)
        audit = audited(rng, unit_twin, design.audit_s, serial)
        units.append((kind, kind.wired(recording).unlabelled, kind.wired(audit)))
    later = np.random.default_rng([seed, GOLDEN])
    golden = _record(later, twins[0], programme(later, design.unit_s), "S0", design.has_stage)
    day = design.line.day(source, np.random.default_rng([seed, DAY]))
    return SimulatedLot(
        source,
        tuple(SimulatedUnit(kind.name, day(recording), audit) for kind, recording, audit in units),
        replace(golden, unlabelled=day(golden.unlabelled)),
    )


def draw_twins(rng: Rng, count: int, spread: LotSpread | None = None, twin: Twin | None = None) -> tuple[Twin, ...]:
    """Draw (count,) units of one lot, the source unit first.

    They share a nominal unit, creep, hysteresis and readout lag of their own, nearly alike in all;
    or `twin` and its effects, of a diagnosis for example.
    """
    nominal = twin or Twin(_nominal(rng), _mild_effects(rng))
    units = draw_lot(rng, count, nominal, spread or LotDesign().spread)
    return tuple(_jitter(rng, unit) for unit in units)


def twin_of(seed: int, serial: str) -> Twin:
    """Return the twin of one serial of a simulated lot: the same for the same seed and serial."""
    rng, unit_rng = np.random.default_rng(seed), np.random.default_rng([seed, crc32(serial.encode())])
    (twin,) = draw_lot(unit_rng, 1, Twin(_nominal(rng), _mild_effects(rng)), LotDesign().spread)
    return _jitter(unit_rng, twin)


def draw_lot(rng: Rng, count: int, nominal: Twin | None = None, spread: LotSpread | None = None) -> tuple[Twin, ...]:
    """Draw (count,) units of one lot around a nominal unit, with its effects at the same size.

    Deviations are normal, cut at two standard deviations, so no unit is beyond physical sense.
    """
    nominal, spread = nominal or Twin(), spread or LotSpread()
    base = nominal.parameters

    def deviation() -> float:
        return float(np.clip(rng.normal(), -2.0, 2.0))

    def draw_parameters() -> BaseParameters:
        return BaseParameters(
            u0_mm=base.u0_mm + spread.u0_mm * deviation(),
            k1_N_mm=base.k1_N_mm * (1 + spread.k1 * deviation()),
            k3_N_mm3=base.k3_N_mm3 * (1 + spread.k3 * deviation()),
            r0_ohm=base.r0_ohm * (1 + spread.r0 * deviation()),
            kappa_per_N=base.kappa_per_N * (1 + spread.kappa * deviation()),
            sigma_output_V=base.sigma_output_V * (1 + spread.noise * deviation()),
            sigma_force_N=base.sigma_force_N * (1 + spread.noise * deviation()),
        )

    return tuple(Twin(draw_parameters(), nominal.effects, nominal.metadata) for _ in range(count))


def _nominal(rng: Rng) -> BaseParameters:
    base = BaseParameters()
    return base.with_values(
        k1_N_mm=base.k1_N_mm * rng.uniform(0.8, 1.2),
        k3_N_mm3=base.k3_N_mm3 * rng.uniform(0.5, 1.2),
        kappa_per_N=base.kappa_per_N * rng.uniform(0.6, 1.0),
        sigma_output_V=base.sigma_output_V * rng.uniform(0.5, 3.0),
    )


def _mild_effects(rng: Rng) -> tuple[EffectSetting, ...]:
    return (
        EffectSetting("channel_creep", {"c": rng.uniform(0, 0.04), "tau": rng.uniform(1, 10)}),
        EffectSetting("channel_hysteresis", {"a": rng.uniform(0, 0.04), "f0": rng.uniform(0.5, 2)}),
        EffectSetting("readout_lag", {"tau": rng.uniform(0.005, 0.08)}),
    )


def _jitter(rng: Rng, twin: Twin) -> Twin:
    effects = tuple(
        replace(effect, values={name: value * rng.uniform(0.8, 1.2) for name, value in effect.values.items()})
        for effect in twin.effects
    )
    return replace(twin, effects=effects)


def _record(rng: Rng, twin: Twin, profile: Profile, serial: str, has_stage: bool) -> LabelledRecording:
    rate_Hz = twin.metadata.sample_rate_Hz
    t_s, stage_mm = profile.sample(rate_Hz)
    force_N, output_V = simulate(twin, t_s, stage_mm, rng)
    return LabelledRecording(
        OutputRecording(serial, t_s, output_V, rate_Hz, stage_mm=stage_mm if has_stage else None), force_N
    )


SHIFTS: Mapping[str, Callable[[Rng, float], Profile]] = {
    "none": source_profile,
    "short profile": unit_profile,
    "lighter": lambda rng, duration_s: unit_profile(rng, duration_s, 0.88 * DEPTH_MM),
    "harder": lambda rng, duration_s: unit_profile(rng, duration_s, 1.08 * DEPTH_MM),
    # The cube root: half the force is reached well beyond half the depth.
    "half range": lambda rng, duration_s: unit_profile(rng, duration_s, 0.72 * DEPTH_MM),
    "other dwell": lambda rng, duration_s: ramps([DEPTH_MM], 3.0, rest_s=1.0).then(
        random_presses(rng, duration_s, DEPTH_MM, fastest_mm_s=2.0, return_share=0.15), "other dwell"
    ),
}
"""Label shift by name: the profile of the units' recordings; audits keep the source's programme."""

PROGRAMMES: Mapping[str, Callable[[Rng, float], Profile]] = {
    **SHIFTS,
    "own programme": lambda rng, duration_s: random_presses(rng, duration_s, DEPTH_MM),
    # A third of the depth and a bit: less than a third of the force.
    "below half": lambda rng, duration_s: random_presses(rng, duration_s, rng.uniform(0.35, 0.5) * DEPTH_MM),
}
"""Every profile units can be recorded under: the shifts the method was set on, and others."""
