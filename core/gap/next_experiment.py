"""What to press next: the run that best tells the rivals apart, per minute of bench time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from softcal.core import profiles
from softcal.core.gap.case import Case, Run
from softcal.core.gap.fit import Fit, fit
from softcal.core.gap.linear import dots, energy, gram
from softcal.core.gap.method import METHOD
from softcal.core.profiles import Profile
from softcal.core.twin.probes import Extent
from softcal.core.words.reason import Reason, in_words, reason, several

SET_UP_min: Mapping[str, float] = {
    "press": 0.5,
    "rest": 0.5,
    "dummy_resistor": 1.0,
    "dead_weights": 2.0,
    "rigid_block": 1.0,
}
REST_s = 120.0
LEVELS = 6


@dataclass(frozen=True)
class MenuEntry:
    """One experiment that may be proposed: its run, channels still zeros, and minutes with set-up."""

    name: str
    run: Run
    minutes: float


@dataclass(frozen=True)
class NextExperiment:
    """The proposed run, and by how many standard deviations refitted rivals stand apart over it."""

    profile: str
    why: Reason
    separation_sigma: float = 0.0
    minutes: float = 0.0

    def record(self) -> dict[str, object]:
        return in_words(vars(self), "why")


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


def propose(case: Case, rivals: Sequence[Fit], extent: Extent) -> NextExperiment | None:
    """Return the experiment that tells most rivals from the first, best per minute; None without rivals.

    Their distance is what the second's prediction keeps from the first's after that was refitted to the
    old runs and the new one together (T-optimality with refit, to first order).
    """
    return None if len(rivals) < 2 else most_telling(menu(case, extent), rivals)


def most_telling(entries: Sequence[MenuEntry], rivals: Sequence[Fit]) -> NextExperiment:
    """Return the entry that tells most rivals from the first, and does so best per minute."""
    first, others, enough = rivals[0], rivals[1:], METHOD.telling.enough_sigma
    candidates: list[tuple[int, float, float, MenuEntry]] = []
    # A larger hypothesis can take the shape of a smaller one.
    pairs = [[(a, b) for a, b in ((first, other), (other, first)) if not set(a.ids) > set(b.ids)] for other in others]
    for experiment in entries:
        distances = [min(_distance(a, b, experiment.run) for a, b in both) for both in pairs]
        parted = [distance for distance in distances if distance >= enough]
        least = min(parted, default=0.0)
        candidates.append((len(parted), min(least, 10 * enough) / experiment.minutes, least, experiment))
    count, _, distance, experiment = max(candidates, key=lambda entry: entry[:2])
    causes = causes_of(rivals)
    if count == 0:
        remedies = dict.fromkeys(e.signs.remedy for f in rivals for e in f.effects if e.signs.remedy)
        remedy = several([Reason.of(one) for one in remedies] or [Reason("gap.remedy.usual")])
        return NextExperiment("none", reason("gap.next.inseparable", causes=causes, remedy=remedy))
    why = reason("gap.next.separates", causes=causes, distance=distance, minutes=experiment.minutes)
    if count < len(others):
        why = reason("gap.next.separates_most", **why.values, others=len(others) - count)
    return NextExperiment(experiment.name, why, distance, experiment.minutes)


def causes_of(rivals: Sequence[Fit]) -> Reason:
    """Return the causes of hypotheses in words, those of one together."""
    return several([named(f.ids, "gap.together") for f in rivals], "gap.both")


def named(effects: Sequence[str], code: str) -> Reason:
    """Return identifiers of effects as one reason; `code` says how they are joined."""
    return several([reason("gap.effect", effect=effect) for effect in effects], code)


def _distance(mine: Fit, other: Fit, run: Run) -> float:
    """Return how far `other` stays from `mine` on a new run once `mine` is refitted to it too."""
    problem = mine.problem.of_run(run)
    hypothesis = mine.hypothesis.without_episodes()
    theirs = problem.predict(other.hypothesis.without_episodes(), other.coordinates)
    parted = problem.whitened(theirs - problem.predict(hypothesis, mine.coordinates))
    if not np.all(np.isfinite(parted)):
        # A simulator that fails there tells nothing.
        return 0.0
    jacobian = fit(problem, hypothesis, mine.coordinates, steps=0).jacobian
    old = gram(mine.jacobian)
    free = np.flatnonzero(np.diag(old) > 0)
    normal = old[np.ix_(free, free)] + gram(jacobian[free])
    slope = dots(jacobian[free], parted)
    left = energy(parted) - float(slope @ np.linalg.lstsq(normal, slope, rcond=None)[0])
    return float(np.sqrt(max(left, 0.0)))


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
