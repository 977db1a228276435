"""What a fit is of: a hypothesis, and measured channels as one vector with weights."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np

from softcal.core.gap.case import Case, Mask, Run, RunKind
from softcal.core.gap.colour import Colour, ColourConfig, filter_of, filtered
from softcal.core.gap.coordinates import RigScale, from_fit
from softcal.core.gap.forward import dither_V, mean_code_V, predict
from softcal.core.gap.method import METHOD
from softcal.core.gap.offsets import IS_RELATIVE, Directions, Sizes, bases_of, directions, largest_offsets, with_offsets
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Parameter
from softcal.core.twin.parameters import BaseParameters
from softcal.core.twin.simulate import Chain

BASE = (
    Parameter("u0_mm", "mm", -1e4, 1e4, 0.3),
    Parameter("k1_N_mm", "N/mm", 0.0, 1e4, 1.0),
    Parameter("k3_N_mm3", "N/mm³", 0.0, 1e4, 0.1),
    Parameter("r0_ohm", "ohm", 1e-6, 1e9, 4.0, scale="log"),
    Parameter("kappa_per_N", "1/N", 0.0, 1e3, 0.07),
)

QUIETEST = 1e-6
"""Least noise of a force that is believed, N on the common rig."""

SHOWN_ALONE = {"rigid_block": "stage_mm", "dead_weights": "force_N", "dummy_resistor": "output_V"}
"""The one channel that a special run shows."""

Episodes = tuple[Mapping[str, Array], ...]

Around: TypeAlias = Callable[["Hypothesis", Array], Array]
"""Predict, (samples,), near to other coordinates, with a small effect more or less."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """The base with these effects on top.

    Args:
        episodes: per run, the rows of its episodic effects.
        of_all: parameters of the base, which every hypothesis has.
    """

    effects: tuple[Effect, ...] = ()
    episodes: Episodes = ()
    of_all: tuple[Parameter, ...] = BASE

    @cached_property
    def chain(self) -> Chain:
        return Chain(self.effects)

    @cached_property
    def ids(self) -> tuple[str, ...]:
        """Identifiers of the causes, sorted."""
        return tuple(sorted({effect.id for effect in self.effects}))

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters: those of the base, then those of the effects in order."""
        return self.of_all + tuple(p for effect in self.effects for p in effect.parameters)

    def episodes_of(self, run: int) -> Mapping[str, Array]:
        return self.episodes[run] if self.episodes else {}

    @property
    def episode_count(self) -> int:
        """How many episodes were placed."""
        return sum(len(rows) for run in self.episodes for rows in run.values())

    @property
    def of_base(self) -> slice:
        """Where the base parameters stand in the vector of parameters."""
        return slice(0, len(self.of_all))

    @cached_property
    def slices(self) -> dict[str, slice]:
        """Where the parameters of every effect stand among all, the size first, by identifier."""
        ends = np.cumsum([self.of_base.stop, *(len(effect.parameters) for effect in self.effects)])
        return {e.id: slice(int(ends[k]), int(ends[k + 1])) for k, e in enumerate(self.effects)}

    def split(self, coordinates: Array) -> tuple[list[float], list[list[float]]]:
        """Return the values of the base and of every effect at these coordinates of the fit."""
        values = [from_fit(p, float(x)) for p, x in zip(self.parameters, coordinates, strict=True)]
        return values[self.of_base], [values[place] for place in self.slices.values()]

    def place_of(self, effect_id: str) -> int:
        """Return where the size of an effect stands among the coordinates."""
        return int(self.slices[effect_id].start)

    def without(self, effect_id: str) -> tuple["Hypothesis", Mask]:
        """Return this without one effect, and which coordinates, (parameters,), are left."""
        left = np.ones(len(self.parameters), dtype=np.bool_)
        if effect_id in self.slices:
            left[self.slices[effect_id]] = False
        return replace(self, effects=tuple(e for e in self.effects if e.id != effect_id)), left

    def without_episodes(self) -> "Hypothesis":
        """Return the same effects on a run whose episodes nobody knows."""
        return replace(self, episodes=())

    def adding(self, *effects: Effect, episodes: Episodes | None = None) -> "Hypothesis":
        """Return this hypothesis with effects more, or with other realisations of those it has."""
        others = [e for e in self.effects if e.id not in {added.id for added in effects}]
        return replace(self, effects=(*others, *effects), episodes=self.episodes if episodes is None else episodes)


@dataclass(frozen=True)
class Block:
    """Where the samples of one channel of one run stand in the vectors of a problem."""

    run: int
    channel: str
    place: slice


@dataclass(frozen=True, eq=False)
class Problem:
    """The measured channels of a case as one vector with noise weights.

    Args:
        sigma: per channel, standard deviation of the white noise, in the channel's unit.
        use: (samples,) which samples a fit may see; all where None.
        colour: per channel whose noise is not white, the part that fades.
    """

    case: Case
    sigma: Mapping[str, float]
    use: Array | None = None
    extra_variance: Array | None = None
    """(samples,) variance that comes with the noise of the driving channel."""
    has_offsets: bool = True
    """Whether every run may have a zero, an unloaded resistance and a seat of its own."""
    colour: Mapping[str, Colour] = field(default_factory=dict)
    of_rig: RigScale | None = None
    """The size of the rig; read off the runs where None."""

    @cached_property
    def scale(self) -> RigScale:
        return self.of_rig or RigScale.of(self.case)

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        blocks, at = [], 0
        for k, run in enumerate(self.case.runs):
            for channel in self.channels_of_runs[k]:
                blocks.append(Block(k, channel, slice(at, at + len(run))))
                at += len(run)
        return tuple(blocks)

    def blocks_of(self, channel: str, kind: RunKind | None = None) -> list[Block]:
        """Return the blocks of a channel, of runs of one kind where it is given."""
        runs = self.case.runs
        return [b for b in self.blocks if b.channel == channel and kind in (None, runs[b.run].kind)]

    @cached_property
    def measured(self) -> Array:
        """(samples,) all channels of all runs, block by block."""
        return np.concatenate([self.recorded(b.run, b.channel) for b in self.blocks])

    @cached_property
    def channels_of_runs(self) -> list[tuple[str, ...]]:
        """Per run, the recorded channels that are predicted."""
        out: list[tuple[str, ...]] = []
        for run in self.case.runs:
            # What drives the twin is not predicted.
            alone = "output_V" if run.kind == "press" and run.stage_mm is None else SHOWN_ALONE.get(run.kind)
            of_press = (channel for channel in ("force_N", "output_V") if getattr(run, channel) is not None)
            out.append((alone,) if alone else tuple(of_press))
        return out

    def recorded(self, run: int, channel: str) -> Array:
        """Return a recorded channel of a run, (n,)."""
        return np.asarray(getattr(self.case.runs[run], channel))

    @cached_property
    def colour_config(self) -> ColourConfig:
        """How noise that fades is read."""
        return METHOD.colour

    @property
    def smooth_order(self) -> int:
        """Which differences of a residual hold noise alone: second ones where all is quick."""
        return 1

    def least_noise(self, channel: str) -> float:
        """Return the least noise of a channel that is believed: one without any has no weight."""
        return 0.1 * self.case.readout.step_V if channel == "output_V" else QUIETEST * self.scale.factor("N")

    @property
    def scored_channels(self) -> list[str]:
        """Channels whose gap is measured; where the stage stands on a rigid block is none."""
        return [c for c in ("output_V", "force_N") if any(b.channel == c for b in self.blocks)]

    def of_run(self, run: Run) -> "Problem":
        """Return the problem of a run that is not recorded yet, under the same noise."""
        return Problem(
            Case(self.case.serial, (run,), is_planned=True), self.sigma, colour=self.colour, of_rig=self.scale
        )

    @cached_property
    def noise(self) -> Array:
        """(samples,) standard deviation of the noise of every sample."""
        noise = np.concatenate([np.full(b.place.stop - b.place.start, self.sigma[b.channel]) for b in self.blocks])
        return noise if self.extra_variance is None else np.sqrt(noise**2 + self.extra_variance)

    @cached_property
    def slow_noise(self) -> Array:
        """(samples,) standard deviation of white noise as strong as this near zero frequency."""
        if not self.colour:
            return self.noise
        variance = self.noise**2
        for block in (b for b in self.blocks if b.channel in self.colour):
            step_s = float(np.median(self.case.runs[block.run].step_s))
            variance[block.place] += self.colour[block.channel].slow_variance(step_s)
        return np.sqrt(variance)

    @cached_property
    def whole_noise(self) -> Array:
        """(samples,) standard deviation of the noise, the part that fades included."""
        noise = self.noise.copy()
        for block in (b for b in self.blocks if b.channel in self.colour):
            noise[block.place] = np.hypot(noise[block.place], self.colour[block.channel].spread)
        return noise

    def floor(self, channel: str) -> float:
        """Return the standard deviation of the noise of a channel, the part that fades included."""
        fading = self.colour[channel].spread if channel in self.colour else 0.0
        return float(np.hypot(self.sigma[channel], fading))

    @cached_property
    def weights(self) -> Array:
        """(samples,) 1/σ of the white noise, 0 where a fit may not look."""
        return 1.0 / self.noise if self.use is None else self.use / self.noise

    def whitened(self, values: Array) -> Array:
        """Return (samples,) independent values over their noise, 0 where a fit may not look."""
        out = np.asarray(values * self.weights)
        for block, steps in self._filters:
            out[block.place] = filtered(values[block.place], steps)
        return out

    @cached_property
    def _filters(self) -> list[tuple[Block, Array]]:
        use, found = np.ones(len(self.measured)) if self.use is None else self.use, []
        for block in (b for b in self.blocks if b.channel in self.colour):
            step_s, of = self.case.runs[block.run].step_s, self.colour[block.channel]
            seen = use[block.place].astype(np.float64)
            found.append((block, filter_of(self.noise[block.place], seen, step_s, of.spread, of.fading_s)))
        return found

    @cached_property
    def is_free(self) -> Array:
        """(5,) which base parameters these channels determine."""
        case = self.case
        stage, force, output = (case.has(c) for c in ("stage_mm", "force_N", "output_V"))
        # Without a force only κ·k1 and κ·k3 act; k1 stays and κ takes their common factor.
        return np.array([stage, stage and force, stage, output, output])

    @cached_property
    def largest_offsets(self) -> Array:
        """(k,) bounds of what every run has of its own: here a zero, a resistance and a seat."""
        return largest_offsets(self.case)

    @property
    def are_relative(self) -> Mask:
        """(k,) of which offsets only what the runs differ by is taken off."""
        return IS_RELATIVE

    @property
    def are_bending(self) -> Mask:
        """(k,) which offsets move a channel other than in proportion."""
        return IS_RELATIVE

    @property
    def is_driven_by_force(self) -> bool:
        """Whether a measured force, with its noise, drives the chain in place of a stage."""
        return self.extra_variance is not None

    @cached_property
    def dither_V(self) -> float | None:
        """Noise before an ADC that is coarse against it; None where its stairs do not show."""
        if "output_V" not in self.sigma:
            return None
        return dither_V(self.floor("output_V"), self.case.readout.step_V)

    @property
    def count(self) -> int:
        """Samples a fit may see."""
        return int(np.count_nonzero(self.weights))

    def predict(self, hypothesis: Hypothesis, coordinates: Array) -> Array:
        """Return the clean prediction, (samples,), at these coordinates of the fit."""
        return self.predict_around(hypothesis, coordinates)[0]

    def predict_around(self, hypothesis: Hypothesis, coordinates: Array) -> tuple[Array, "Around"]:
        """Return the clean prediction, (samples,), and what foretells it nearby in one pass."""
        out = self.clean(hypothesis, coordinates, {})
        if not self.has_offsets or self.case.is_planned or not len(self.largest_offsets):
            return self._known(out), self.predict
        out, nearby = with_offsets(self, hypothesis, coordinates, out)
        out = nearby.added(self, out)

        def around(other: Hypothesis, near: Array) -> Array:
            return self._known(nearby.added(self, self.clean(other, near, nearby.moved)))

        return self._known(out), around

    def offset_sizes(self, hypothesis: Hypothesis, coordinates: Array) -> dict[int, Array]:
        """Return by run, (k,), what it has of its own at these coordinates."""
        clean, nearby = with_offsets(self, hypothesis, coordinates, self.clean(hypothesis, coordinates, {}))
        sizes = nearby.sizes(self, clean)
        return {run: size + nearby.moved.get(run, 0.0) for run, size in sizes.items()}

    def _known(self, out: Array) -> Array:
        # A sample nobody can foretell costs what a right prediction would: ignorance wins nothing.
        unknown = np.isnan(out)
        return np.where(unknown, self.measured - self.noise, out) if unknown.any() else out

    def directions(self, hypothesis: Hypothesis, coordinates: Array, clean: Array, sizes: Sizes) -> Directions:
        """Return how a prediction with these offsets in it changes with each of them."""
        return directions(self, BaseParameters(*hypothesis.split(coordinates)[0]), clean, sizes)

    def clean(self, hypothesis: Hypothesis, coordinates: Array, sizes: Sizes) -> Array:
        """Return the (samples,) prediction with these offsets in it, NaN where nobody can know."""
        given, values = hypothesis.split(coordinates)
        base = BaseParameters(*given)
        own = bases_of(base, sizes)
        out = np.empty(len(self.measured))
        last, channels = -1, {}
        for block in self.blocks:
            # One pass of the chain gives all channels of a run.
            if block.run != last:
                run, last, mine = self.case.runs[block.run], block.run, own.get(block.run, base)
                channels = predict(run, last, mine, hypothesis.chain, values, hypothesis.episodes_of(last))
            channel = channels.get(block.channel)
            if block.channel == "output_V" and self.dither_V is not None and channel is not None:
                channel = mean_code_V(channel, self.dither_V, self.case.readout.step_V)
            out[block.place] = self.measured[block.place] if channel is None else channel
            if block.channel == "force_N" and block.run in sizes:
                out[block.place] += sizes[block.run][0]
        return out

    def seeing(self, use: Array) -> "Problem":
        """Return the same problem with other samples open to the fit."""
        return replace(self, use=use)

    @cached_property
    def bare(self) -> "Problem":
        """The same problem with one zero, one resistance and one seat for all runs."""
        return replace(self, has_offsets=False)

    def with_noise(self, sigma: Mapping[str, float], colour: Mapping[str, Colour] | None = None) -> "Problem":
        """Return the same problem under other noise, of the same colour where none is given."""
        return replace(self, sigma=sigma, colour=self.colour if colour is None else colour)
