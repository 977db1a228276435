"""Simulated lots on the twin: good units, planted bad ones and shifted loads, with the truth beside them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from zlib import crc32

import numpy as np

from softcal.core.errors import InputError
from softcal.core.profiles import Profile, ramps, random_presses, source_profile, unit_profile
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin, simulate
from softcal.core.twin.spread import LotSpread, draw_lot

GOOD = "good"
DEPTH_MM = 3.5
OPPOSITE_DIRECTION, STILL = "reversed", "dead"
DAY = 86_400
"""Sets the draw of a day apart from all other draws of a lot."""
GOLDEN = 86_401
"""The same for the golden run."""


@dataclass(frozen=True)
class LineEffects:
    """What the line does to the units' recordings and not to their audits: nothing unlabelled shows it.

    Args:
        load_spread: standard deviation of the load at equal travel from unit to unit, as a share of it: stiffness,
            contact and mounting on the press.
        day_gain: standard deviation of the gain of the readout on the day the units were recorded, one for the lot.
        day_zero: the same for its zero, as a share of the range of the source's output.
    """

    load_spread: float = 0.0
    day_gain: float = 0.0
    day_zero: float = 0.0


@dataclass(frozen=True)
class LotDesign:
    """What kind of lot to simulate.

    Args:
        good: number of units in good order.
        bad: number of units per planted fault, names of `FAULTS`.
        shift: how the loads of the units' recordings differ from the source's, a name of `PROGRAMMES`.
        source_s, unit_s, audit_s: length of the recordings.
        has_stage: whether the recordings carry the stage position.
        spread: how the units differ. What they differ by in stiffness and contact position changes the load at equal
            travel, which no unlabelled recording shows; the default takes pads from one mould, all else by tens of
            per cent.
        twin: the nominal unit and its effects, of a diagnosis for example; None draws them.
        line: what the line does to the units' recordings beside the shift.
    """

    good: int = 6
    bad: Mapping[str, int] | None = None
    shift: str = "none"
    source_s: float = 170.0
    unit_s: float = 60.0
    audit_s: float = 120.0
    has_stage: bool = False
    spread: LotSpread = LotSpread(u0_mm=0.005, k1=0.003, k3=0.003)
    twin: Twin | None = None
    line: LineEffects = LineEffects()

    def __post_init__(self) -> None:
        for kind, name, known in [
            ("shift", self.shift, PROGRAMMES),
            *(("fault", name, FAULTS) for name in self.bad or {}),
        ]:
            if name not in known:
                raise InputError(f"{kind} {name!r} is unknown; known: {', '.join(known)}")


@dataclass(frozen=True, eq=False)
class SimulatedUnit:
    """One unit of a simulated lot.

    Args:
        kind: `good` or the name of the planted fault.
        recording: what the line would record.
        audit: a labelled recording of the source's programme, for the truth and for a calibration of its own.
    """

    kind: str
    recording: OutputRecording
    audit: LabelledRecording

    @property
    def serial(self) -> str:
        return self.recording.serial


@dataclass(frozen=True, eq=False)
class SimulatedLot:
    """A source unit and the units made with it; the source once more in the units' sitting, under the load cell."""

    source: LabelledRecording
    units: tuple[SimulatedUnit, ...]
    golden: LabelledRecording


def simulate_lot(seed: int, design: LotDesign | None = None) -> SimulatedLot:
    """Simulate a lot; equal seed and design give equal recordings.

    Every lot has its own nominal unit and its own mild creep, hysteresis and readout lag, which its units share up to
    a fifth of their size.
    """
    design, rng = design or LotDesign(), np.random.default_rng(seed)
    kinds = [GOOD] * design.good + [name for name, count in (design.bad or {}).items() for _ in range(count)]
    twins = draw_twins(rng, len(kinds) + 1, design.spread, design.twin)
    source = _record(rng, twins[0], source_profile(rng, design.source_s, DEPTH_MM), "S0", design.has_stage)
    units = tuple(
        _simulate_unit(rng, twin, kind, f"U{k:03d}", design)
        for k, (twin, kind) in enumerate(zip(twins[1:], kinds, strict=True), start=1)
    )
    later = np.random.default_rng([seed, GOLDEN])
    golden = _record(later, twins[0], PROGRAMMES[design.shift](later, design.unit_s), "S0", design.has_stage)
    day = _day(source, np.random.default_rng([seed, DAY]), design.line)
    units = tuple(replace(unit, recording=day(unit.recording)) for unit in units)
    return SimulatedLot(source, units, replace(golden, unlabelled=day(golden.unlabelled)))


def draw_twins(
    rng: np.random.Generator, count: int, spread: LotSpread | None = None, twin: Twin | None = None
) -> tuple[Twin, ...]:
    """Draw the units of one lot: their own nominal unit, creep, hysteresis and readout lag, nearly alike in all.

    Args:
        twin: the nominal unit and its effects, of a diagnosis for example; None draws both.

    Returns:
        (count,) twins, the source unit first.
    """
    nominal = twin or Twin(_nominal(rng), _mild_effects(rng))
    twins = draw_lot(rng, count, nominal.parameters, nominal.metadata, nominal.effects, spread or LotDesign().spread)
    return tuple(_jitter(rng, twin) for twin in twins)


def twin_of(seed: int, serial: str) -> Twin:
    """Return the twin of one serial of a simulated lot: the same for the same seed and serial, in any order.

    Args:
        seed: of the lot: its nominal unit and its effects.
    """
    rng, own = np.random.default_rng(seed), np.random.default_rng([seed, crc32(serial.encode())])
    nominal, effects = _nominal(rng), _mild_effects(rng)
    (twin,) = draw_lot(own, 1, nominal, ReadoutMetadata(), effects, LotDesign().spread)
    return _jitter(own, twin)


def _nominal(rng: np.random.Generator) -> BaseParameters:
    base = BaseParameters()
    return replace(
        base,
        k1_N_mm=base.k1_N_mm * rng.uniform(0.8, 1.2),
        k3_N_mm3=base.k3_N_mm3 * rng.uniform(0.5, 1.2),
        kappa_per_N=base.kappa_per_N * rng.uniform(0.6, 1.0),
        sigma_output_V=base.sigma_output_V * rng.uniform(0.5, 3.0),
    )


def _mild_effects(rng: np.random.Generator) -> tuple[EffectSetting, ...]:
    return (
        EffectSetting("channel_creep", {"c": rng.uniform(0, 0.04), "tau": rng.uniform(1, 10)}),
        EffectSetting("channel_hysteresis", {"a": rng.uniform(0, 0.04), "f0": rng.uniform(0.5, 2)}),
        EffectSetting("readout_lag", {"tau": rng.uniform(0.005, 0.08)}),
    )


def _jitter(rng: np.random.Generator, twin: Twin) -> Twin:
    effects = tuple(
        replace(effect, values={name: value * rng.uniform(0.8, 1.2) for name, value in effect.values.items()})
        for effect in twin.effects
    )
    return replace(twin, effects=effects)


def _simulate_unit(rng: np.random.Generator, twin: Twin, kind: str, serial: str, design: LotDesign) -> SimulatedUnit:
    faulty = twin if kind == GOOD else FAULTS[kind](rng, twin)
    profile = PROGRAMMES[design.shift](rng, design.unit_s)
    if kind == "wrong programme":
        profile = ramps([rng.uniform(0.2, 0.5) * DEPTH_MM] * 6, rng.uniform(0.1, 0.4), rest_s=0.2)
    recording = _record(rng, _pressed(rng, faulty, design.line), profile, serial, design.has_stage)
    audit = _record(rng, faulty, source_profile(rng, design.audit_s, DEPTH_MM), serial, design.has_stage)
    return SimulatedUnit(kind, _rewired(recording, kind).unlabelled, _rewired(audit, kind))


def _pressed(rng: np.random.Generator, twin: Twin, line: LineEffects) -> Twin:
    """Return the unit as the press of the line meets it: its load at equal travel is off by a factor."""
    if not line.load_spread:
        return twin
    factor, base = 1 + line.load_spread * float(np.clip(rng.normal(), -2.0, 2.0)), twin.parameters
    return replace(twin, parameters=replace(base, k1_N_mm=factor * base.k1_N_mm, k3_N_mm3=factor * base.k3_N_mm3))


def _day(
    source: LabelledRecording, rng: np.random.Generator, line: LineEffects
) -> Callable[[OutputRecording], OutputRecording]:
    """Return how the readout shows a recording on the day of the units; source and audits have another one."""
    if not (line.day_gain or line.day_zero):
        return lambda recording: recording
    low, high = np.quantile(source.unlabelled.output, (0.02, 0.98))
    gain, zero_V = 1 + line.day_gain * rng.normal(), line.day_zero * (high - low) * rng.normal()
    return lambda recording: replace(recording, output=low + gain * (recording.output - low) + zero_V)


def _record(rng: np.random.Generator, twin: Twin, profile: Profile, serial: str, has_stage: bool) -> LabelledRecording:
    rate_Hz = twin.metadata.sample_rate_Hz
    t_s, stage_mm = profile.sample(rate_Hz)
    force_N, output_V = simulate(twin, t_s, stage_mm, rng)
    return LabelledRecording(
        OutputRecording(serial, t_s, output_V, rate_Hz, stage_mm=stage_mm if has_stage else None), force_N
    )


def _rewired(recording: LabelledRecording, kind: str) -> LabelledRecording:
    """Return the recording as a line with this wiring fault would show it."""
    raw = recording.unlabelled
    if kind == OPPOSITE_DIRECTION:
        return replace(recording, unlabelled=replace(raw, output=ReadoutMetadata().vref_V - raw.output))
    if kind == STILL:
        return replace(recording, unlabelled=replace(raw, output=np.full(len(raw), raw.output[0])))
    return recording


def _with(twin: Twin, name: str, **values: float) -> Twin:
    others = tuple(effect for effect in twin.effects if effect.effect_id != name)
    return replace(twin, effects=(*others, EffectSetting(name, values)))


def _same(rng: np.random.Generator, twin: Twin) -> Twin:
    return twin


def _saturated(rng: np.random.Generator, twin: Twin) -> Twin:
    base, readout = twin.parameters, twin.metadata
    rest_ohm = base.r0_ohm
    # Force at full depth: where in the range between rest and there the readout clips.
    depth_mm = DEPTH_MM - base.u0_mm
    peak_ohm = rest_ohm / (1 - base.kappa_per_N * (base.k1_N_mm * depth_mm + base.k3_N_mm3 * depth_mm**3))
    rest_V, peak_V = (readout.vref_V * ohm / (ohm + readout.r_series_ohm) for ohm in (rest_ohm, peak_ohm))
    return _with(twin, "adc_saturation", V_max=rest_V + rng.uniform(0.3, 0.7) * (peak_V - rest_V))


def _other_sensor(rng: np.random.Generator, twin: Twin) -> Twin:
    if rng.random() < 0.5:
        return _with(twin, "readout_lag", tau=rng.uniform(0.25, 0.8))
    parameters = replace(twin.parameters, kappa_per_N=rng.uniform(0.1, 0.2))
    return replace(twin, parameters=parameters, metadata=replace(twin.metadata, sensor_type="strain"))


def _extra_creep(rng: np.random.Generator, twin: Twin) -> Twin:
    return _with(twin, "channel_creep", c=rng.uniform(0.15, 0.4), tau=float(np.exp(rng.uniform(np.log(2), np.log(30)))))


FAULTS: Mapping[str, Callable[[np.random.Generator, Twin], Twin]] = {
    STILL: _same,
    "saturated": _saturated,
    OPPOSITE_DIRECTION: _same,
    "other sensor": _other_sensor,
    "wrong programme": _same,
    "extra creep": _extra_creep,
}
"""Planted faults by name: what they do to the twin; wiring and programme act on the recording."""


def _scaled(factor: float) -> Callable[[np.random.Generator, float], Profile]:
    return lambda rng, duration_s: unit_profile(rng, duration_s, factor * DEPTH_MM)


def _half_range(rng: np.random.Generator, duration_s: float) -> Profile:
    # The cube root: half the force is reached well beyond half the depth.
    return unit_profile(rng, duration_s, 0.72 * DEPTH_MM)


def _own_programme(rng: np.random.Generator, duration_s: float) -> Profile:
    return random_presses(rng, duration_s, DEPTH_MM)


def _below_half(rng: np.random.Generator, duration_s: float) -> Profile:
    # A third of the depth and a bit: less than a third of the force.
    return random_presses(rng, duration_s, rng.uniform(0.35, 0.5) * DEPTH_MM)


def _other_dwell(rng: np.random.Generator, duration_s: float) -> Profile:
    return ramps([DEPTH_MM], 3.0, rest_s=1.0).then(
        random_presses(rng, duration_s, DEPTH_MM, fastest_mm_s=2.0, return_share=0.15), "other dwell"
    )


SHIFTS: Mapping[str, Callable[[np.random.Generator, float], Profile]] = {
    "none": source_profile,
    "short profile": unit_profile,
    "lighter": _scaled(0.88),
    "harder": _scaled(1.08),
    "half range": _half_range,
    "other dwell": _other_dwell,
}
"""Label shift by name: the profile of the units' recordings; audits keep the source's programme."""

PROGRAMMES: Mapping[str, Callable[[np.random.Generator, float], Profile]] = {
    **SHIFTS,
    "own programme": _own_programme,
    "below half": _below_half,
}
"""Every profile units can be recorded under: the shifts the method was set on, and others."""
