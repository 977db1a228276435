"""A sealed rig, and the chain of TWIN.md written a second time, with hooks where the causes act."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeAlias

import numpy as np
from scipy.signal import lfilter

from softcal.core.recording import Array, Rng

PRESS, RIGID_BLOCK, DUMMY_RESISTOR = "press", "rigid_block", "dummy_resistor"
DEAD_WEIGHTS, REST = "dead_weights", "rest"
"""Kinds of runs, as `kind` in recording.json."""


@dataclass(frozen=True)
class Rig:
    """Base parameters and metadata of one unit on one rig (TWIN.md, base model).

    `kappa_per_N` is in 1/N, or in 1/mm where `sensor_type` is `strain`. Beside the white noise,
    each channel may have noise that fades with `coloured_s`, of this standard deviation.
    """

    u0_mm: float
    k1_N_mm: float
    k3_N_mm3: float
    r0_ohm: float
    kappa_per_N: float
    noise_V: float
    noise_N: float
    vref_V: float
    r_series_ohm: float
    adc_bits: int
    sample_rate_Hz: float
    sensor_type: str = "pressure"
    coloured_V: float = 0.0
    coloured_N: float = 0.0
    coloured_s: float = 1.0

    def without_noise(self) -> "Rig":
        return replace(self, noise_V=0.0, noise_N=0.0, coloured_V=0.0, coloured_N=0.0)

    @property
    def lsb_V(self) -> float:
        return float(self.vref_V / (2**self.adc_bits - 1))

    @property
    def noise_floor_V(self) -> float:
        """Noise of the output including the rounding of the ADC, RMS."""
        return float(np.hypot(self.noise_V, self.lsb_V / np.sqrt(12.0)))

    def pad_force_N(self, compression_mm: Array) -> Array:
        return self.k1_N_mm * compression_mm + self.k3_N_mm3 * compression_mm**3


@dataclass(frozen=True)
class Cause:
    """One cause: its identifier, the equation that realises it, and its values.

    Args:
        effect: an identifier of TWIN.md's catalogue, or the name of an effect outside it.
        form: `catalogue`, or the name of another equation of the same cause.
    """

    effect: str
    form: str
    values: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Path:
    """Stage path: straight lines between corners, constant before and after them."""

    name: str
    corner_s: Array
    corner_mm: Array

    def position_mm(self, t_s: Array) -> Array:
        return np.asarray(np.interp(t_s, self.corner_s, self.corner_mm))

    @property
    def duration_s(self) -> float:
        return float(self.corner_s[-1])


@dataclass(frozen=True, eq=False)
class Measured:
    """Recording of one run of a sealed rig; `columns` lack the channels that the run does not record."""

    kind: str
    profile: str
    columns: Mapping[str, Array]
    dummy_ohm: float | None = None

    def with_columns(self, **columns: Array) -> "Measured":
        return replace(self, columns={**self.columns, **columns})


SUBSTEPS = 10
"""Grid points per sample: the integration step is a tenth of the sample period."""

TAIL_S = 3.0
"""The rig goes on at rest after the last sample: a late or gapped channel has something to read."""

BLOCK_COMPLIANCE_MM_PER_N = 2e-6
"""Compliance of the rigid block and its seat: next to nothing, so that what yields is the frame."""

FORCE_TOLERANCE_N = 1e-9
ROUNDS = 400
RELAXED = 0.6
"""Share of each correction that is taken: more swings for a frame as soft as the pad."""

NARROWEST = 0.05
"""Smallest 1 − κ·F a rig may reach; beyond it the channel is shut and the model has no answer."""

HOOKS = {
    "position": "motion",
    **dict.fromkeys(("contact", "yielding", "landing", "elastic", "relaxed"), "mechanics"),
    **dict.fromkeys(("channel", "rest_resistance", "resistance"), "transduction"),
    **dict.fromkeys(("lead", "series", "reference", "voltage", "pickup", "limit"), "electronics"),
    "instant": "acquisition",
    "cell": "load_cell",
}
"""Where an equation acts, with its stage in TWIN.md; it maps that place's quantity."""


@dataclass(frozen=True, eq=False)
class Moment:
    """Signals that an equation may use besides the quantity it changes, all on one time grid."""

    rig: Rig
    t_s: Array
    step_s: float
    stage_mm: Array
    temperature_C: Array
    rng: Rng
    compression_mm: Array
    force_N: Array


Apply: TypeAlias = Callable[..., Array]


class Equation(NamedTuple):
    """One equation of an effect: a hook, and a function of value, moment and parameters."""

    hook: str
    apply: Apply

    @property
    def stage(self) -> str:
        return HOOKS[self.hook]


class Rack:
    """The equations of one rig's causes, by hook."""

    def __init__(self, causes: Sequence[Cause], equations: Mapping[tuple[str, str], Equation]) -> None:
        self._steps: dict[str, list[tuple[Apply, Mapping[str, float]]]] = {hook: [] for hook in HOOKS}
        for cause in causes:
            equation = equations[cause.effect, cause.form]
            self._steps[equation.hook].append((equation.apply, cause.values))

    def has(self, hook: str) -> bool:
        return bool(self._steps[hook])

    def pass_through(self, hook: str, value: Array, moment: Moment) -> Array:
        """Apply every cause of a hook to the value, in the given order."""
        for apply, values in self._steps[hook]:
            value = apply(value, moment, **values)
        return value


def record(
    rig: Rig,
    rack: Rack,
    path: Path,
    temperature: Callable[[Array], Array],
    rng: Rng,
    kind: str = PRESS,
    dummy_ohm: float | None = None,
    known_force: Callable[[Array], Array] | None = None,
) -> Measured:
    """Run one recording: `t_s, stage_mm, force_N, output_V, temperature_C`, more or less by its kind.

    Args:
        rng: noise, and whatever an equation draws for this run.
        kind: of TWIN.md; `rigid_block`, `dummy_resistor`, `dead_weights` replace the pressed unit.
        known_force: force of a `dead_weights` run at given times.
    """
    sample_s: Array = np.arange(int(path.duration_s * rig.sample_rate_Hz) + 1, dtype=np.float64) / rig.sample_rate_Hz
    step_s = 1.0 / (rig.sample_rate_Hz * SUBSTEPS)
    t_s: Array = np.arange(int((sample_s[-1] + TAIL_S) / step_s) + 1, dtype=np.float64) * step_s
    nothing = np.zeros_like(t_s)
    moment = Moment(rig, t_s, step_s, path.position_mm(t_s), temperature(t_s), rng, nothing, nothing)
    moment = _press(rack, moment, kind, known_force)
    volts = _output(rack, moment, sample_s, dummy_ohm)
    cell_N = rack.pass_through("cell", moment.force_N, moment)
    force_N = np.interp(sample_s, moment.t_s, cell_N) + rng.normal(0.0, rig.noise_N, len(sample_s))
    columns = {
        "t_s": sample_s,
        "stage_mm": path.position_mm(sample_s),
        "force_N": force_N + _wander(rig, rig.coloured_N, rng, len(sample_s)),
        "output_V": volts,
        "temperature_C": temperature(sample_s),
    }
    if known_force is not None:
        columns["known_force_N"] = known_force(sample_s)
    present = {name: column for name, column in columns.items() if name not in _ABSENT.get(kind, ())}
    return Measured(kind, path.name, present, dummy_ohm)


_ABSENT = {RIGID_BLOCK: ("output_V",), DUMMY_RESISTOR: ("stage_mm", "force_N"), DEAD_WEIGHTS: ("stage_mm", "output_V")}


def _press(rack: Rack, moment: Moment, kind: str, known_force: Callable[[Array], Array] | None) -> Moment:
    if known_force is not None:
        return replace(moment, force_N=known_force(moment.t_s))
    if kind == DUMMY_RESISTOR:
        return moment
    position_mm = rack.pass_through("position", moment.stage_mm, moment)
    contact_mm = rack.pass_through("contact", np.full_like(position_mm, moment.rig.u0_mm), moment)
    travel_mm = position_mm - contact_mm
    if kind == RIGID_BLOCK:
        compliance = BLOCK_COMPLIANCE_MM_PER_N + rack.pass_through(
            "yielding", np.zeros_like(travel_mm), replace(moment, force_N=np.ones_like(travel_mm))
        )
        return replace(moment, force_N=np.maximum(0.0, travel_mm) / compliance)
    for _ in range(ROUNDS):
        # The frame yields by what it would under the force of the round before.
        yielding_mm = rack.pass_through("yielding", np.zeros_like(travel_mm), moment)
        compression_mm = np.maximum(0.0, travel_mm - yielding_mm)
        compression_mm = np.maximum(0.0, rack.pass_through("landing", compression_mm, moment))
        moment_pressed = replace(moment, compression_mm=compression_mm)
        force_N = rack.pass_through("elastic", moment.rig.pad_force_N(compression_mm), moment_pressed)
        force_N = rack.pass_through("relaxed", force_N, moment_pressed)
        change_N = force_N - moment.force_N
        if not rack.has("yielding") or float(np.max(np.abs(change_N))) < FORCE_TOLERANCE_N:
            return replace(moment_pressed, force_N=force_N)
        moment = replace(moment, force_N=moment.force_N + RELAXED * change_N)
    raise ValueError("the frame is softer than the pad; its compression has no fixed point")


def _output(rack: Rack, moment: Moment, sample_s: Array, dummy_ohm: float | None) -> Array:
    """Return the codes of the ADC at the sampling instants: transduction, electronics and acquisition."""
    rig = moment.rig
    if dummy_ohm is None:
        load = moment.compression_mm if rig.sensor_type == "strain" else moment.force_N
        load = rack.pass_through("channel", load, moment)
        rest_ohm = rack.pass_through("rest_resistance", np.full_like(load, rig.r0_ohm), moment)
        width = 1.0 - rig.kappa_per_N * load
        if float(width.min()) < NARROWEST:
            raise ValueError(f"the channel is pressed shut: 1 - kappa*F = {float(width.min()):.3f}")
        resistance = rack.pass_through("resistance", rest_ohm / width, replace(moment, force_N=load))
    else:
        resistance = np.full_like(moment.t_s, dummy_ohm)
    resistance = rack.pass_through("lead", resistance, moment)
    series = rack.pass_through("series", np.full_like(resistance, rig.r_series_ohm), moment)
    reference_V = rack.pass_through("reference", np.full_like(resistance, rig.vref_V), moment)
    volts = rack.pass_through("voltage", reference_V * resistance / (resistance + series), moment)
    instants_s = rack.pass_through("instant", sample_s, moment)
    sampled = np.asarray(np.interp(instants_s, moment.t_s, volts))
    # A sample that was lost took its share of the hum with it.
    at_samples = replace(moment, t_s=instants_s, step_s=1.0 / rig.sample_rate_Hz)
    sampled = rack.pass_through("pickup", sampled, at_samples)
    noisy = sampled + moment.rng.normal(0.0, rig.noise_V, len(sampled))
    noisy = noisy + _wander(rig, rig.coloured_V, moment.rng, len(sampled))
    clipped = np.clip(rack.pass_through("limit", noisy, at_samples), 0.0, rig.vref_V)
    return np.asarray(np.round(clipped / rig.lsb_V) * rig.lsb_V)


def _wander(rig: Rig, spread: float, rng: Rng, count: int) -> Array:
    """(count,) noise of this standard deviation whose correlation fades with exp(-t/coloured_s)."""
    if spread == 0.0:
        return np.zeros(count)
    decay = np.exp(-1.0 / (rig.sample_rate_Hz * rig.coloured_s))
    kicks = rng.normal(0.0, spread * np.sqrt(1.0 - decay**2), count)
    # It has been running for ever when the recording begins.
    kicks[0] = rng.normal(0.0, spread)
    return np.asarray(lfilter([1.0], [1.0, -decay], kicks))
