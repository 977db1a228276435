"""What the twin says of runs of a soft sensor: where it begins, which effects show, its prediction, what to press next.

Departures that no effect of the catalogue covers: a signal may have a gain or an offset that follows time or
temperature, the load cell a delay or a share of the position. Where one wins, the report says `unknown`.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import product
from operator import attrgetter
from typing import Any, TypeAlias

import numpy as np
from scipy.optimize import nnls

from softcal.core import profiles
from softcal.core.gap.case import Case, MenuEntry, RigScale, Run, RunKind
from softcal.core.gap.hypothesis import BASE, to_fit
from softcal.core.gap.model import Fit, Problem
from softcal.core.profiles import Profile
from softcal.core.recording import Array
from softcal.core.twin.catalogue import EFFECTS
from softcal.core.twin.effects import Alias, ChainStage, Effect, Flow, Hook, Memory, Parameter, Step
from softcal.core.twin.electronics import dither_V
from softcal.core.twin.empirical_terms import TERM_TARGETS, VARIABLES, EmpiricalTerm
from softcal.core.twin.mechanics import elastic_force
from softcal.core.twin.parameters import BaseParameters
from softcal.core.twin.probes import ExcitationRange
from softcal.core.twin.signals import compiled, low_pass
from softcal.core.twin.simulate import Chain, Values

SET_UP_min: Mapping[str, float] = {
    "press": 0.5,
    "rest": 0.5,
    "dummy_resistor": 1.0,
    "dead_weights": 2.0,
    "rigid_block": 1.0,
}
REST_s = 120.0
LEVELS = 6


def first_noise(case: Case) -> dict[str, float]:
    """Return noise per channel that is no less than what a base that is not fitted yet leaves."""
    of_rig = RigScale.from_case(case)
    levels = {
        "force_N": 0.02 * of_rig.factor("N"),
        "output_V": case.readout.step_V,
        "stage_mm": 0.002 * of_rig.factor("mm"),
    }
    for channel in ("force_N", "output_V"):
        if values := case.recorded(channel):
            spread = float(np.std(np.concatenate(values)))
            levels[channel] = max(0.02 * spread, 1e-5 * levels[channel])
    return levels


def rough_start(case: Case) -> Array:
    """Return base coordinates read off the recordings, (5,)."""
    stage, force, output = (
        np.concatenate(case.recorded(c)) if case.has(c) else None for c in ("stage_mm", "force_N", "output_V")
    )
    u0, k1, k3, r0, kappa = (RigScale.from_case(case).sized(p).usual for p in BASE)
    loaded = force if force is not None else output
    if stage is not None and loaded is not None:
        # The lowest twentieth of the stroke is off the pad in every profile.
        rest = float(np.median(loaded[stage <= np.quantile(stage, 0.05)]))
        is_pressed = loaded - rest > 0.03 * (loaded.max() - rest)
        # Not the very first touch: one noisy sample would set it.
        u0 = float(np.quantile(stage[is_pressed], 0.02)) if is_pressed.any() else float(np.median(stage))
        bent = np.maximum(0.0, stage - u0)
        if force is not None:
            # Never negative: a pad that pulls would begin the fit outside its bounds.
            (k1, k3), _ = nnls(np.column_stack([bent, bent**3]), np.maximum(force, 0.0))
        force = k1 * bent + k3 * bent**3
    if output is not None and force is not None:
        readout = case.readout
        resistance = output * readout.r_series_ohm / np.maximum(readout.vref_V - output, readout.step_V)
        drive = np.maximum(0.0, stage - u0) if readout.sensor_type == "strain" and stage is not None else force
        r0 = float(np.median(resistance[drive <= max(np.quantile(drive, 0.1), 0.02 * drive.max())]))
        # At the largest loads the resistance has grown most, so that kappa shows best.
        top = drive >= np.quantile(drive, 0.98)
        kappa = max((1.0 - r0 / float(np.median(resistance[top]))) / float(np.median(drive[top])), 1e-3 * kappa)
    values = (u0, k1, k3, max(r0, 1e-4 * case.readout.r_series_ohm), kappa)
    return np.array([to_fit(p, v) for p, v in zip(BASE, values, strict=True)])


def excitation_of(base: Fit) -> ExcitationRange:
    """Measure a case; depth and force beyond what was recorded come from the fitted base."""
    case = base.problem.case
    depths = [float(stage_mm.max()) for stage_mm in case.recorded("stage_mm")]
    depth_mm = max(depths) - base.base.u0_mm if depths else 1.0
    forces = [float(force_N.max()) for force_N in case.recorded("force_N")]
    force_N = max(forces, default=base.base.k1_N_mm * depth_mm + base.base.k3_N_mm3 * depth_mm**3)
    every_V = np.concatenate(case.recorded("output_V") or [np.array([0.0, 1.0])])
    return ExcitationRange(
        depth_mm=max(depth_mm, 1e-9),
        force_N=max(force_N, 1e-9),
        lowest_V=float(every_V.min()),
        highest_V=float(every_V.max()),
        duration_s=max(float(run.elapsed_s[-1]) for run in case.presses),
        period_s=1.0 / case.readout.sample_rate_Hz,
        series_ohm=case.readout.r_series_ohm,
    )


def visible_effects(case: Case, effects: Mapping[str, Effect] = EFFECTS) -> tuple[Effect, ...]:
    """Return the effects of a list that the recorded channels can show at all."""
    observable = [effect for effect in effects.values() if effect.stage not in case.unseen_stages]
    return tuple(effect for effect in observable if all(map(case.changes, effect.signs.needs)))


def is_resolved(case: Case, alias: Alias) -> bool:
    """Whether a run of the case tells an effect from what looks exactly like it elsewhere."""
    return case.changes(alias.changing, alias.distinguished_by, alias.by)


def terms_of_twin(base: Fit) -> Iterator[EmpiricalTerm]:
    """Give the terms that runs can show; a load and a depth of 1 are the base's largest."""
    problem, case = base.problem, base.problem.case
    if case.has("stage_mm"):
        depth_mm = max(float(np.max(np.asarray(run.stage_mm))) for run in case.presses) - base.base.u0_mm
        depth_mm = max(depth_mm, 1e-9)
        load_N = float(elastic_force(np.array(depth_mm), base.base.k1_N_mm, base.base.k3_N_mm3))
    else:
        load_N = depth_mm = max(float(np.max(run.driving_force.force_N)) for run in case.presses)
    for target, name in product(TERM_TARGETS, VARIABLES):
        is_observable = case.has("stage_mm") if target == "F" else target in problem.scored_channels
        if is_observable and (not VARIABLES[name].needs or case.has(VARIABLES[name].needs)):
            yield EmpiricalTerm(target, name, 0.0, load_N, depth_mm)


def menu(case: Case, excitation: ExcitationRange) -> tuple[MenuEntry, ...]:
    """Return what can be recorded here: profiles to the depth already pressed, and special runs."""
    d, rate_Hz, series_ohm = excitation.depth_mm, case.readout.sample_rate_Hz, case.readout.r_series_ohm
    entries: list[MenuEntry] = []

    def add(name: str, minutes: float, title: str, t_s: Array, kind: RunKind, **columns: Any) -> None:
        run = Run(title, t_s, case.readout, kind=kind, is_planned=True, **columns)
        entries.append(MenuEntry(name, run, SET_UP_min[kind] + minutes))

    def zeros(t_s: Array) -> dict[str, Array]:
        return {name: np.zeros(len(t_s)) for name in ("force_N", "output_V") if case.has(name)}

    profiles_by_name: dict[str, Profile] = {}
    if case.has("stage_mm"):
        profiles_by_name = {
            "rate_sweep": profiles.rate_sweep(d),
            "steps_with_holds": profiles.steps_with_holds([0.4 * d, 0.7 * d, d, 0.5 * d], hold_s=20.0),
            "long_hold": profiles.long_hold(d, 300.0),
            "amplitude_ladder": profiles.amplitude_ladder(d),
            "slow_touch_down": profiles.slow_touch_down(min(0.8, d)),
            "small_reversals": profiles.small_reversals(d),
            "fast_ramps": profiles.ramps([d] * 10, 3.0, name="fast ramps"),
        }
    for name, profile in profiles_by_name.items():
        t_s, stage_mm = profile.sample(rate_Hz)
        add(name, profile.duration_s / 60, profile.name, t_s, "press", stage_mm=stage_mm, **zeros(t_s))
    still_s, t_s = (np.arange(int(duration_s * rate_Hz)) / rate_Hz for duration_s in (REST_s, 60.0))
    add("rest", REST_s / 60, "rest", still_s, "rest", **zeros(still_s))
    nothing, part = np.zeros(len(t_s)), t_s / t_s[-1]
    for ohm in (0.5 * series_ohm, 2.0 * series_ohm) if case.has("output_V") else ():
        add("dummy_resistor", 1.0, "dummy", t_s, "dummy_resistor", output_V=nothing, dummy_ohm=ohm)
    if case.has("force_N"):
        stairs = excitation.force_N * np.floor(part * (LEVELS - 1e-9)) / (LEVELS - 1)
        add("dead_weights", 1.0, "weights", t_s, "dead_weights", force_N=nothing, known_force_N=stairs)
    if case.has("force_N") and case.has("stage_mm"):
        up_down = 1.0 - np.abs(2 * part - 1.0)
        force_N = excitation.force_N * up_down
        add("rigid_block", 1.0, "block", t_s, "rigid_block", stage_mm=up_down, force_N=force_N)
    return tuple(entries)


def explanatory_chain_signals(result: Fit, channel: str) -> list[Array]:
    """Return what the chain of the base knows, (samples,) each, 0 outside the pressed runs."""
    problem, out, config = result.problem, dict[str, Array](), result.problem.method.noise_test
    blocks = [b for b in problem.blocks_of(channel, "press") if problem.case.runs[b.run].stage_mm is not None]
    runs = [problem.case.runs[b.run] for b in blocks]
    depths = [np.maximum(np.asarray(run.stage_mm) - result.base.u0_mm, 0.0) for run in runs]
    loads = [elastic_force(depth, result.base.k1_N_mm, result.base.k3_N_mm3) for depth in depths]
    deepest, largest = (max((float(part.max()) for part in p), default=1.0) or 1.0 for p in (depths, loads))
    for block, run, depth_mm, load_N in zip(blocks, runs, depths, loads, strict=True):
        t_s, depth, load = run.elapsed_s, depth_mm / deepest, load_N / largest
        rate, furthest = np.gradient(load, t_s), np.maximum.accumulate(depth)
        way, columns = np.sign(rate), dict[str, Array]()
        for k in range(config.hats):
            near = np.maximum(0.0, 1.0 - config.hats * np.abs(depth - (k + 1) / config.hats))
            columns[f"depth {k}"] = near * (depth > 0.0)
        columns |= {"time": t_s, "load · time": load * t_s}
        columns |= {"way": way, "load · way": load * way, "load² · way": load**2 * way}
        columns |= {"rate": rate, "load · rate": load * rate}
        columns |= {"acceleration": np.gradient(np.gradient(depth, t_s), t_s), "position": np.asarray(run.stage_mm)}
        columns |= {"deepest so far": furthest, "load · deepest so far": load * furthest}
        if run.temperature_rise_K is not None:
            columns |= {"temperature": run.temperature_rise_K, "load · temperature": load * run.temperature_rise_K}
        for tau_s in config.memory_s:
            remembered = low_pass(load, run.step_s, tau_s, np.zeros(2))
            columns |= {f"memory {tau_s}": remembered, f"load · memory {tau_s}": load * remembered}
        for name, column in columns.items():
            out.setdefault(name, np.zeros(len(problem.measured)))[block.rows] = column
    return list(out.values())


TIME, WARMTH, POSITION = attrgetter("t_s"), attrgetter("warmed_K"), attrgetter("stage_mm")
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


def _unmodelled(
    code: str, stage: ChainStage, hook: Hook, step: Step, unit: str, usual: float, is_signed: bool = True
) -> Effect:
    size = Parameter("size", unit, -30.0 * usual if is_signed else 0.0, 30.0 * usual, usual, neutral=0.0)
    return Effect(code, stage, hook, "", "no effect of the catalogue", (size,), step)


UNMODELLED_EFFECTS = (
    _unmodelled("gap.like.stiffness_in_time", "mechanics", Hook.FORCE, changing("force_N", TIME), "1/s", 1e-3),
    _unmodelled("gap.like.stiffness_when_warm", "mechanics", Hook.FORCE, changing("force_N", WARMTH), "1/K", 5e-3),
    _unmodelled("gap.like.sensitivity_in_time", "transduction", Hook.CHANNEL, changing("drive", TIME), "1/s", 1e-3),
    _unmodelled("gap.like.sensitivity_when_warm", "transduction", Hook.CHANNEL, changing("drive", WARMTH), "1/K", 5e-3),
    _unmodelled("gap.like.offset_in_time", "electronics", Hook.OUTPUT, _offset("output_V", TIME), "V/s", 2e-4),
    _unmodelled("gap.like.offset_when_warm", "electronics", Hook.OUTPUT, _offset("output_V", WARMTH), "V/K", 1e-3),
    _unmodelled("gap.like.cell_span_in_time", "load_cell", Hook.READING, changing("reading_N", TIME), "1/s", 1e-3),
    _unmodelled("gap.like.cell_span_when_warm", "load_cell", Hook.READING, changing("reading_N", WARMTH), "1/K", 5e-3),
    _unmodelled("gap.like.cell_zero_when_warm", "load_cell", Hook.READING, _offset("reading_N", WARMTH), "N/K", 0.01),
    _unmodelled("gap.like.cell_by_position", "load_cell", Hook.READING, _offset("reading_N", POSITION), "N/mm", 0.05),
    _unmodelled("gap.like.cell_late", "load_cell", Hook.READING, _cell_lag, "s", 0.1, is_signed=False),
)
"""Generic departures; the identifier is the reason that says what one is like."""

WARM_DIVIDER = _unmodelled("gap.like.divider_when_warm", "electronics", Hook.REFERENCE, _divider, "1/K", 1e-3)
"""Looks like a channel that follows the temperature, sign reversed, while the channel is read."""


RETRACTED_mm = -1e3
"""Stage position that stands for a rest: far above the pad."""

INVERSE_STEPS = 4
"""Fixed-point steps from a reading back to a force: a few per cent are undone to 1e-6."""

TOUCHING_share = 0.05
"""A rigid block is taken as touched above this share of the largest force."""

Prediction: TypeAlias = dict[str, Array]
"""Clean channels that a run can show, (n,) each, NaN where nobody can know; of a rigid block `stage_mm`, where the
stage must be when this force is read."""


def predict_run(
    run: Run, index: int, base: BaseParameters, chain: Chain, values: Values, episodes: Mapping[str, Array]
) -> Prediction:
    """Return what the base twin with the effects of a chain says of one run.

    Args:
        index: position of the run in its case, for effects with values of their own per run.
    """
    stage_mm = run.elapsed_s if run.stage_mm is None else run.stage_mm
    flow = Flow(run.elapsed_s, run.step_s, stage_mm, run.temperature_rise_K, run.readout.vref_V, episodes, index)
    if run.kind == "rigid_block":
        return _rigid_block(run, flow, chain, values)
    if run.kind == "dead_weights":
        flow.force_N = np.asarray(run.known_force_N)
        chain.weigh(flow, values, chain.fresh_memories())
        return {"force_N": flow.reading_N}
    if run.kind == "dummy_resistor":
        flow.resistance_ohm = np.full(len(run), float(run.dummy_ohm or 0.0))
        chain.read_out(flow, run.readout, values, chain.fresh_memories())
        return {"output_V": _read_output(flow)}
    if run.kind == "rest":
        flow.stage_mm = np.full(len(run), RETRACTED_mm)
    elif run.stage_mm is None:
        force_N = reading_N = run.driving_force.force_N
        for _ in range(INVERSE_STEPS):
            flow.force_N = force_N
            chain.weigh(flow, values, chain.fresh_memories())
            # What the cell would read beyond its reading is taken off the force until both agree.
            force_N = force_N + reading_N - flow.reading_N
        flow.force_N = flow.deformation_mm = force_N
        chain.sense(flow, base, run.readout, values, chain.fresh_memories())
        return {"output_V": _read_output(flow)}
    chain.run(flow, base, run.readout, values, chain.fresh_memories())
    return {"force_N": flow.reading_N, "output_V": _read_output(flow)}


def _read_output(flow: Flow) -> Array:
    # Not np.clip, which takes three times as long.
    output_V = np.minimum(np.maximum(flow.output_V, 0.0), flow.vref_V)
    return output_V if flow.is_unforeseeable is None else np.where(flow.is_unforeseeable, np.nan, output_V)


def _rigid_block(run: Run, flow: Flow, chain: Chain, values: Values) -> Prediction:
    """A rigid block gives way as the frame does: u − play = const + c_f·F while touched."""
    force_N = np.asarray(run.force_N)
    flow.pad_mm = flow.stage_mm
    memories = chain.fresh_memories()
    chain.apply(Hook.MOTION, flow, values, memories)
    chain.apply(Hook.CONTACT, flow, values, memories)
    is_touched = force_N > TOUCHING_share * force_N.max()
    bent_mm = flow.compliance_mm_N * force_N + (flow.stage_mm - flow.pad_mm)
    if not is_touched.any():
        return {"stage_mm": flow.stage_mm}
    # Nobody measured where the block stands: its level is what the touched samples say on average.
    level_mm = float(np.mean((flow.stage_mm - bent_mm)[is_touched]))
    return {"stage_mm": np.where(is_touched, level_mm + bent_mm, flow.stage_mm)}


def dither_of(problem: "Problem") -> float | None:
    """Return the noise before an ADC that is coarse against it; None where its stairs do not show."""
    if "output_V" not in problem.sigma:
        return None
    return dither_V(problem.noise_floor("output_V"), problem.case.readout.step_V)


def bases_of(base: BaseParameters, sizes: Mapping[int, Array]) -> dict[int, BaseParameters]:
    """Return the base of every run that has one of its own."""
    return {
        run: base.with_values(u0_mm=base.u0_mm + seat, r0_ohm=base.r0_ohm * (1.0 + resistance))
        for run, (_, resistance, seat) in sizes.items()
    }


@compiled
def offset_rows(
    kinds: tuple[bool, bool], stage_mm: Array, clean: Array, vref_V: float, base: tuple[float, float, float, float]
) -> Array:
    """(3, n) change of a channel per N of tare, share of R0 and mm of seat, by the base."""
    is_force, is_strain = kinds
    u0_mm, k1_N_mm, k3_N_mm3, kappa_per_N = base
    out = np.zeros((3, len(clean)))
    for k in range(len(clean)):
        depth_mm = max(stage_mm[k] - u0_mm, 0.0)
        force_per_mm = -(k1_N_mm + 3.0 * k3_N_mm3 * depth_mm**2) if depth_mm > 0.0 else 0.0
        if is_force:
            out[0, k], out[2, k] = 1.0, force_per_mm
        elif not np.isnan(clean[k]):
            out[1, k] = clean[k] * (1.0 - clean[k] / vref_V)
            drive = depth_mm if is_strain else k1_N_mm * depth_mm + k3_N_mm3 * depth_mm**3
            per_mm = (-1.0 if depth_mm > 0.0 else 0.0) if is_strain else force_per_mm
            # A fit on its way may drive the base's resistance to infinity.
            out[2, k] = out[1, k] * kappa_per_N / max(1.0 - kappa_per_N * drive, 0.05) * per_mm
    return out
