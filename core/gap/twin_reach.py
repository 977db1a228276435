"""What recordings of a soft sensor reach: where its twin begins, which effects show, what can be pressed next."""

from collections.abc import Iterator, Mapping
from itertools import product

import numpy as np
from scipy.optimize import nnls

from softcal.core import profiles
from softcal.core.gap.case import Case, MenuEntry, Run
from softcal.core.gap.coordinates import RigScale, to_fit
from softcal.core.gap.fit import Fit
from softcal.core.gap.problem import BASE
from softcal.core.profiles import Profile
from softcal.core.recording import Array
from softcal.core.twin.catalogue import EFFECTS
from softcal.core.twin.effects import Alias, Effect
from softcal.core.twin.empirical_terms import PLACES, VARIABLES, EmpiricalTerm
from softcal.core.twin.mechanics import elastic_force
from softcal.core.twin.probes import Extent
from softcal.core.twin.signals import low_pass

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
    of_rig = RigScale.of(case)
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
    u0, k1, k3, r0, kappa = (RigScale.of(case).sized(p).usual for p in BASE)
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


def extent_of(base: Fit) -> Extent:
    """Measure a case; depth and force beyond what was recorded come from the fitted base."""
    case = base.problem.case
    depths = [float(stage_mm.max()) for stage_mm in case.recorded("stage_mm")]
    depth_mm = max(depths) - base.base.u0_mm if depths else 1.0
    forces = [float(force_N.max()) for force_N in case.recorded("force_N")]
    force_N = max(forces, default=base.base.k1_N_mm * depth_mm + base.base.k3_N_mm3 * depth_mm**3)
    every_V = np.concatenate(case.recorded("output_V") or [np.array([0.0, 1.0])])
    return Extent(
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
    seen = [effect for effect in effects.values() if effect.stage not in case.unseen_stages]
    return tuple(effect for effect in seen if all(map(case.changes, effect.signs.needs)))


def is_told(case: Case, alias: Alias) -> bool:
    """Whether a run of the case tells an effect from what looks exactly like it elsewhere."""
    return case.changes(alias.changing, alias.told_by, alias.by)


def terms_of_twin(base: Fit) -> Iterator[EmpiricalTerm]:
    """Give the terms that runs can show; a load and a depth of 1 are the base's largest."""
    problem, case = base.problem, base.problem.case
    if case.has("stage_mm"):
        depth_mm = max(float(np.max(np.asarray(run.stage_mm))) for run in case.presses) - base.base.u0_mm
        depth_mm = max(depth_mm, 1e-9)
        load_N = float(elastic_force(np.array(depth_mm), base.base.k1_N_mm, base.base.k3_N_mm3))
    else:
        load_N = depth_mm = max(float(np.max(run.driving_force.force_N)) for run in case.presses)
    for place, name in product(PLACES, VARIABLES):
        is_seen = case.has("stage_mm") if place == "F" else place in problem.scored_channels
        if is_seen and (not VARIABLES[name].needs or case.has(VARIABLES[name].needs)):
            yield EmpiricalTerm(place, name, 0.0, load_N, depth_mm)


def menu(case: Case, extent: Extent) -> tuple[MenuEntry, ...]:
    """Return what can be recorded here: profiles to the depth already pressed, and special runs."""
    d, rate_Hz = extent.depth_mm, case.readout.sample_rate_Hz
    pressed: dict[str, Profile] = {}
    if case.has("stage_mm"):
        pressed = {
            "rate_sweep": profiles.rate_sweep(d),
            "steps_with_holds": profiles.steps_with_holds([0.4 * d, 0.7 * d, d, 0.5 * d], hold_s=20.0),
            "long_hold": profiles.long_hold(d, 300.0),
            "amplitude_ladder": profiles.amplitude_ladder(d),
            "slow_touch_down": profiles.slow_touch_down(min(0.8, d)),
            "small_reversals": profiles.small_reversals(d),
            "fast_ramps": profiles.ramps([d] * 10, 3.0, name="fast ramps"),
        }
    entries = []
    for name, profile in pressed.items():
        t_s, stage_mm = profile.sample(rate_Hz)
        force, output = (np.zeros(len(t_s)) if case.has(name) else None for name in ("force_N", "output_V"))
        run = Run(profile.name, t_s, case.readout, stage_mm, force, output, is_planned=True)
        entries.append(MenuEntry(name, run, SET_UP_min["press"] + profile.duration_s / 60))
    return (*entries, *_special(case, extent.force_N, rate_Hz))


def _special(case: Case, force_N: float, rate_Hz: float) -> tuple[MenuEntry, ...]:
    t_s = np.arange(int(60 * rate_Hz)) / rate_Hz
    zeros, readout = np.zeros(len(t_s)), case.readout
    stairs = np.floor(t_s / t_s[-1] * (LEVELS - 1e-9)) / (LEVELS - 1)
    up_down = 1.0 - np.abs(2 * t_s / t_s[-1] - 1.0)
    still_s, still = np.arange(int(REST_s * rate_Hz)) / rate_Hz, np.zeros(int(REST_s * rate_Hz))
    force, output = (still if case.has(name) else None for name in ("force_N", "output_V"))
    rest = Run("rest", still_s, readout, force_N=force, output_V=output, kind="rest", is_planned=True)
    out = [MenuEntry("rest", rest, SET_UP_min["rest"] + REST_s / 60)]
    if case.has("output_V"):
        for ohm in (0.5 * readout.r_series_ohm, 2.0 * readout.r_series_ohm):
            run = Run("dummy", t_s, readout, output_V=zeros, dummy_ohm=ohm, kind="dummy_resistor", is_planned=True)
            out.append(MenuEntry("dummy_resistor", run, SET_UP_min["dummy_resistor"] + 1.0))
    if case.has("force_N"):
        weights = Run(
            "weights", t_s, readout, force_N=zeros, known_force_N=force_N * stairs, kind="dead_weights", is_planned=True
        )
        out.append(MenuEntry("dead_weights", weights, SET_UP_min["dead_weights"] + 1.0))
        if case.has("stage_mm"):
            block = Run(
                "block", t_s, readout, stage_mm=up_down, force_N=force_N * up_down, kind="rigid_block", is_planned=True
            )
            out.append(MenuEntry("rigid_block", block, SET_UP_min["rigid_block"] + 1.0))
    return tuple(out)


def known_by_chain(found: Fit, channel: str) -> list[Array]:
    """Return what the chain of the base knows, (samples,) each, 0 outside the pressed runs."""
    problem, out, config = found.problem, dict[str, Array](), found.problem.method.floor
    blocks = [b for b in problem.blocks_of(channel, "press") if problem.case.runs[b.run].stage_mm is not None]
    runs = [problem.case.runs[b.run] for b in blocks]
    depths = [np.maximum(np.asarray(run.stage_mm) - found.base.u0_mm, 0.0) for run in runs]
    loads = [elastic_force(depth, found.base.k1_N_mm, found.base.k3_N_mm3) for depth in depths]
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
            out.setdefault(name, np.zeros(len(problem.measured)))[block.place] = column
    return list(out.values())
