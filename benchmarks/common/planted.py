"""Bad units planted into simulated lots, and lines that press and read their units differently."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from softcal.core.profiles import Profile, ramps
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.simulated_lot import DEPTH_MM, SteadyLine, UnitKind
from softcal.core.twin.parameters import ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin

OPPOSITE_DIRECTION = "reversed"


@dataclass(frozen=True)
class LineEffects(SteadyLine):
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

    def press_unit(self, rng: np.random.Generator, twin: Twin) -> Twin:
        """Return the unit as the press of the line meets it: its load at equal travel is off by a factor."""
        if not self.load_spread:
            return twin
        factor, base = 1 + self.load_spread * float(np.clip(rng.normal(), -2.0, 2.0)), twin.parameters
        return replace(twin, parameters=replace(base, k1_N_mm=factor * base.k1_N_mm, k3_N_mm3=factor * base.k3_N_mm3))

    def day(self, source: LabelledRecording, rng: np.random.Generator) -> Callable[[OutputRecording], OutputRecording]:
        """Return how the readout shows a recording on the day of the units."""
        if not (self.day_gain or self.day_zero):
            return lambda recording: recording
        low, high = np.quantile(source.unlabelled.output, (0.02, 0.98))
        gain, zero_V = 1 + self.day_gain * rng.normal(), self.day_zero * (high - low) * rng.normal()
        return lambda recording: replace(recording, output=low + gain * (recording.output - low) + zero_V)


def _reversed(recording: LabelledRecording) -> LabelledRecording:
    raw = recording.unlabelled
    return replace(recording, unlabelled=replace(raw, output=ReadoutMetadata().vref_V - raw.output))


def _still(recording: LabelledRecording) -> LabelledRecording:
    raw = recording.unlabelled
    return replace(recording, unlabelled=replace(raw, output=np.full(len(raw), raw.output[0])))


def _with(twin: Twin, name: str, **values: float) -> Twin:
    others = tuple(effect for effect in twin.effects if effect.effect_id != name)
    return replace(twin, effects=(*others, EffectSetting(name, values)))


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


def _wrong_programme(rng: np.random.Generator) -> Profile:
    return ramps([rng.uniform(0.2, 0.5) * DEPTH_MM] * 6, rng.uniform(0.1, 0.4), rest_s=0.2)


FAULTS: Mapping[str, UnitKind] = {
    kind.name: kind
    for kind in (
        UnitKind("dead", wired=_still),
        UnitKind("saturated", _saturated),
        UnitKind(OPPOSITE_DIRECTION, wired=_reversed),
        UnitKind("other sensor", _other_sensor),
        UnitKind("wrong programme", profile=_wrong_programme),
        UnitKind("extra creep", _extra_creep),
    )
}
"""Planted faults by name: what they do to the twin, the wiring or the programme."""


def planted(names: Iterable[str], count: int = 1) -> Mapping[UnitKind, int]:
    """Return so many units of each of these faults, as the design of a lot takes them."""
    return {FAULTS[name]: count for name in names}
