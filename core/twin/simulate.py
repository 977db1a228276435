"""A twin: its chain from stage position to recording, at once or as a stream, and its record."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np

from softcal.core.errors import InputError
from softcal.core.recording import Array
from softcal.core.twin.catalogue import EFFECTS, effect
from softcal.core.twin.effects import Effect, Flow, Hook, Memory
from softcal.core.twin.electronics import digitise
from softcal.core.twin.empirical_terms import EmpiricalTerm
from softcal.core.twin.mechanics import press
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.transduction import channel_resistance

Values: TypeAlias = Sequence[Sequence[float]]
"""Parameter values of the effects of a chain, one row per effect."""

ORDER = {name: position for position, name in enumerate(EFFECTS)}


@dataclass(frozen=True)
class EffectSetting:
    """One effect with its parameter values, switched on.

    Args:
        values: parameter values by name; a missing parameter has its usual value. Constants
            of a form are required.
        episodes: rows of an episodic effect, in s since the start of the run: (start, stop) of each
            bad contact, or (instant, count) of each loss of samples.
        form: its other equation that acts, as `Form` names it; the catalogue's where empty.

    Raises:
        InputError: unknown effect, form or parameter, or a value that is missing or not finite.
    """

    effect_id: str
    values: Mapping[str, float] = field(default_factory=dict)
    episodes: tuple[tuple[float, float], ...] = ()
    form: str = ""

    def __post_init__(self) -> None:
        names = self.effect.value_names
        for name, value in self.values.items():
            if name not in names:
                raise InputError(f"{self.effect_id} has no parameter {name!r}; known are {', '.join(names)}")
            if not np.isfinite(value):
                raise InputError(f"{self.effect_id}.{name} is {value}; a finite number was expected")
        for name, _ in self.effect.constants:
            if name not in self.values:
                raise InputError(f"{self.effect_id}, {self.form}: {name} is missing among its values")

    @property
    def effect(self) -> Effect:
        """The effect; an effect with several forms is chosen by the given parameters."""
        catalogue_effect = effect(self.effect_id)
        if not self.form:
            return catalogue_effect.find_side(tuple(self.values))
        form_effect = catalogue_effect.find_form(self.form)
        if form_effect is None:
            form_names = ", ".join(repr(form.effect.equation) for form in catalogue_effect.forms) or "none"
            raise InputError(f"{self.effect_id} has no form {self.form!r}; known are {form_names}")
        return form_effect

    @property
    def ordered_values(self) -> tuple[float, ...]:
        usual = {p.name: p.usual for p in self.effect.parameters}
        return tuple(float(self.values.get(name, usual.get(name, np.nan))) for name in self.effect.value_names)


@dataclass(frozen=True)
class Twin:
    """The simulator of one unit on the station: base parameters, effects, electronics.

    >>> import numpy as np, softcal
    >>> from softcal.core.profiles import ramps
    >>> from softcal.core.twin.simulate import simulate
    >>> t_s, stage_mm = ramps([1.0, 2.0], speed_mm_s=1.0).sample(50)
    >>> force_N, output_V = simulate(softcal.Twin(), t_s, stage_mm, np.random.default_rng(1))
    >>> force_N.shape == output_V.shape == t_s.shape
    True

    Args:
        empirical: terms for the residual that no effect explains; each acts after the effects of its signal.
    """

    parameters: BaseParameters = BaseParameters()
    effects: tuple[EffectSetting, ...] = ()
    metadata: ReadoutMetadata = ReadoutMetadata()
    empirical: tuple[EmpiricalTerm, ...] = ()

    def __post_init__(self) -> None:
        ids = [setting.effect_id for setting in self.effects]
        # Twice the same cause would share its size, and no fit could tell the two apart.
        if len(set(ids)) < len(ids):
            raise InputError(f"an effect is switched on twice: {', '.join(ids)}")

    @property
    def clean(self) -> "Twin":
        return Twin(self.parameters, (), self.metadata)


class Chain:
    """The stages in the order of the signal, with the effects that are switched on.

    Args:
        effects: in any order; each acts at its hook, at one hook in the order of the catalogue.
    """

    def __init__(self, effects: Sequence[Effect]) -> None:
        self.effects = tuple(effects)
        # Effects of one hook do not commute (a ceiling and hum): the catalogue decides.
        order = sorted(range(len(effects)), key=lambda k: ORDER.get(effects[k].id, len(ORDER)))
        self._at = {hook: [k for k in order if effects[k].hook == hook] for hook in Hook}

    def fresh_memories(self) -> list[Memory]:
        return [{} for _ in self.effects]

    def apply(self, hook: Hook, flow: Flow, values: Values, memories: Sequence[Memory]) -> None:
        """Apply every effect of this hook to the flow; values and memories have one row per effect."""
        for k in self._at[hook]:
            self.effects[k].step(flow, values[k], memories[k])

    def press(self, flow: Flow, base: BaseParameters, values: Values, memories: Sequence[Memory]) -> None:
        flow.pad_mm, flow.contact_mm = flow.stage_mm, base.u0_mm
        self.apply(Hook.MOTION, flow, values, memories)
        self.apply(Hook.CONTACT, flow, values, memories)
        press(flow, base)
        self.apply(Hook.FORCE, flow, values, memories)

    def sense(
        self, flow: Flow, base: BaseParameters, readout: ReadoutMetadata, values: Values, memories: Sequence[Memory]
    ) -> None:
        flow.drive = flow.deformation_mm if readout.sensor_type == "strain" else flow.force_N
        self.apply(Hook.CHANNEL, flow, values, memories)
        flow.resistance_ohm = channel_resistance(flow.drive, base.r0_ohm, base.kappa_per_N)
        self.apply(Hook.RESISTANCE, flow, values, memories)
        self.read_out(flow, readout, values, memories)

    def read_out(self, flow: Flow, readout: ReadoutMetadata, values: Values, memories: Sequence[Memory]) -> None:
        flow.wiring_ohm, flow.reference_V = 0.0, flow.vref_V
        self.apply(Hook.REFERENCE, flow, values, memories)
        resistance = flow.resistance_ohm + flow.wiring_ohm
        flow.output_V = flow.reference_V * (resistance / (resistance + readout.r_series_ohm))
        self.apply(Hook.OUTPUT, flow, values, memories)
        self.apply(Hook.CLOCK, flow, values, memories)

    def weigh(self, flow: Flow, values: Values, memories: Sequence[Memory]) -> None:
        flow.reading_N = flow.force_N
        self.apply(Hook.READING, flow, values, memories)

    def run(
        self, flow: Flow, base: BaseParameters, readout: ReadoutMetadata, values: Values, memories: Sequence[Memory]
    ) -> None:
        """Pass one stretch of a run through the whole chain, without noise and ADC.

        Args:
            flow: time, stage position and temperature; the rest is written.
        """
        self.press(flow, base, values, memories)
        self.sense(flow, base, readout, values, memories)
        self.weigh(flow, values, memories)


StreamState: TypeAlias = tuple[list[Memory], float | None, float, list[Mapping[str, Any]]]
"""Memories of the effects, the last instant, the first temperature, and the generators of both noises."""


class TwinStream:
    """A twin in use: it takes stage positions in time order and returns force and output.

    The same samples in chunks of any size give the same numbers as in one call, where it is causal.

    Args:
        rng: source of the noise; None for a unit without noise. The ADC always rounds.
    """

    def __init__(self, twin: Twin, rng: np.random.Generator | None) -> None:
        self._twin = twin
        # A stream for each channel: what one draws must not depend on how the other is chunked.
        self._rng = rng.spawn(2) if rng is not None else None
        self._last_t_s: float | None = None
        self._chain = Chain([*(s.effect for s in twin.effects), *(term.effect for term in twin.empirical)])
        self._values = [*(s.ordered_values for s in twin.effects), *((t.coefficient,) for t in twin.empirical)]
        self.restart()

    @property
    def is_causal(self) -> bool:
        """Whether no effect asks for later instants: chunks of any size give the same numbers."""
        return not any(effect.hook is Hook.CLOCK for effect in self._chain.effects)

    def state(self) -> StreamState:
        """Return the present state, on which `advance` depends."""
        memories = [{name: value.copy() for name, value in memory.items()} for memory in self._memories]
        noise = [rng.bit_generator.state for rng in self._rng or ()]
        return memories, self._last_t_s, self._first_temperature_C, noise

    def go_back(self, state: StreamState) -> None:
        """Restore an earlier state of this stream, including its noise."""
        memories, self._last_t_s, self._first_temperature_C, noise = state
        self._memories = [{name: value.copy() for name, value in memory.items()} for memory in memories]
        for rng, before in zip(self._rng or (), noise, strict=True):
            rng.bit_generator.state = before

    def restart(self) -> None:
        """Start a new run from rest; the noise continues."""
        self._memories, self._last_t_s = self._chain.fresh_memories(), None
        self._first_temperature_C = 0.0

    def advance(self, t_s: Array, stage_mm: Array, temperature_C: Array | None = None) -> tuple[Array, Array]:
        """Return force_N and output_V, (n,) each, at the next n instants of the run.

        Args:
            t_s: (n,) time since the start of the run, strictly increasing over all calls.
            stage_mm: (n,) stage position, positive when it compresses.
            temperature_C: (n,) temperature of the channel, where an effect depends on it.

        Raises:
            ValueError: time does not go on, or lengths differ.
        """
        t_s = np.asarray(t_s, dtype=np.float64)
        stage_mm = np.asarray(stage_mm, dtype=np.float64)
        if len(t_s) != len(stage_mm):
            raise ValueError(f"t_s has {len(t_s)} samples, stage_mm {len(stage_mm)}")
        if not len(t_s):
            return np.empty(0), np.empty(0)
        step_s = np.empty_like(t_s)
        step_s[0] = 0.0 if self._last_t_s is None else t_s[0] - self._last_t_s
        np.subtract(t_s[1:], t_s[:-1], out=step_s[1:])
        if (step_s[1:] <= 0.0).any() or (self._last_t_s is not None and step_s[0] <= 0.0):
            raise ValueError("t_s must go on: every instant later than the one before")
        rise_K = None
        if temperature_C is not None:
            if self._last_t_s is None:
                # Parameters hold at the start of a run, so that a rise counts from there.
                self._first_temperature_C = float(temperature_C[0])
            rise_K = np.asarray(temperature_C, dtype=np.float64) - self._first_temperature_C
        self._last_t_s = float(t_s[-1])
        base, readout = self._twin.parameters, self._twin.metadata
        episodes = {s.effect_id: np.array(s.episodes) for s in self._twin.effects if s.episodes}
        flow = Flow(t_s, step_s, stage_mm, rise_K, readout.vref_V, episodes)
        self._chain.run(flow, base, readout, self._values, self._memories)
        noise_N, noise_V = np.zeros(len(t_s)), np.zeros(len(t_s))
        if self._rng is not None:
            force, output = self._rng
            noise_N = force.normal(0.0, base.sigma_force_N, len(t_s))
            noise_V = output.normal(0.0, base.sigma_output_V, len(t_s))
        return flow.reading_N + noise_N, digitise(flow.output_V, noise_V, readout)


def simulate(
    twin: Twin, t_s: Array, stage_mm: Array, rng: np.random.Generator | None = None, temperature_C: Array | None = None
) -> tuple[Array, Array]:
    """Return force_N and output_V, (n,) each, of one run that starts from rest at t_s[0].

    Args:
        t_s: (n,) strictly increasing instants in s.
        stage_mm: (n,) stage position in mm.
        rng: source of the noise; None for no noise.
        temperature_C: (n,) temperature of the channel.
    """
    return TwinStream(twin, rng).advance(np.asarray(t_s) - t_s[0], stage_mm, temperature_C)


SCHEMA = "softcal.twin/1"
TERM = ("place", "variable", "coefficient", "load_N", "depth_mm")


def twin_record(twin: Twin) -> dict[str, Any]:
    """Return a twin as JSON values."""
    return {
        "schema": SCHEMA,
        "parameters": dict(vars(twin.parameters)),
        "metadata": dict(vars(twin.metadata)),
        "effects": [
            {
                "effect": s.effect_id,
                "values": dict(s.values),
                "episodes": [list(row) for row in s.episodes],
                "form": s.form,
            }
            for s in twin.effects
        ],
        "empirical": [{name: getattr(term, name) for name in (*TERM, "unit")} for term in twin.empirical],
    }


def twin_from_record(record: Mapping[str, Any], source: str) -> Twin:
    """Return the twin of a record.

    Raises:
        InputError: it does not describe a twin.
    """
    try:
        if record["schema"] != SCHEMA:
            raise InputError(f"{source}: schema {record['schema']!r}; {SCHEMA} was expected")
        effects = tuple(
            EffectSetting(
                e["effect"], e["values"], tuple((float(a), float(b)) for a, b in e["episodes"]), str(e["form"])
            )
            for e in record["effects"]
        )
        terms = []
        for e in record["empirical"]:
            numbers = (float(e[name]) for name in ("coefficient", "load_N", "depth_mm"))
            terms.append(term := EmpiricalTerm(e["place"], e["variable"], *numbers))
            if e["unit"] != term.unit:
                raise InputError(f"{term.formula}: its coefficient is in {term.unit}, not in {e['unit']}")
        return Twin(
            BaseParameters(**record["parameters"]), effects, ReadoutMetadata(**record["metadata"]), tuple(terms)
        )
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{source}: does not describe a twin ({error}); write it with softcal gap apply") from error
