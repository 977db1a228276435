"""How probable each effect is, what cannot be told apart, what is a rest; how every cause stands in a report.

What a hypothesis leaves may be a rest that nothing in the list says. Then a cause of the list may only imitate a part
of that rest. A cause that is there takes most of what is left once all others are fitted, and has one size in every
part of every run, whatever the rest does. One that imitates takes a part, and asks for more here and less there.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit, logit, softmax

from softcal.core.gap.fit import Map, Regime, Tangent, exact_log_evidence, fit, form_of, share_of_gap, structure
from softcal.core.gap.hypothesis import from_fit, start_coordinates
from softcal.core.gap.linear import energy, orthonormal, projected
from softcal.core.gap.method import PresenceConfig
from softcal.core.gap.model import Fit, Fits
from softcal.core.messages.reason import Reason, reason, with_sentences
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Flow, Memory
from softcal.core.unit.uncertainty import NORMAL_90


@dataclass(frozen=True)
class ParameterEstimate:
    """A fitted parameter of an effect with its 90 % interval."""

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class RankedCause:
    """One effect of the catalogue and how it stands.

    Args:
        shrink: share of the gap that goes with it, of what the set takes; None where it is not in the set.
        parameters: by the catalogue's equation; empty where no hypothesis has it.
        form: the other equation that fits better, empty where the catalogue's does.
        alone, added: share of the gap that goes with it alone, and that comes back without it; None where not fitted.
    """

    effect: str
    stage: str
    probability: float
    shrink: float | None
    parameters: dict[str, ParameterEstimate]
    form: str = ""
    alone: float | None = None
    added: float | None = None


@dataclass(frozen=True)
class FaultLocation:
    """One line of where the gap lies."""

    stage: str
    channel: str
    regime: Reason
    share: float
    detail: Reason = Reason("gap.map.none")

    def record(self) -> dict[str, object]:
        return with_sentences(vars(self), "regime", "detail")


@dataclass(frozen=True)
class Where:
    """Where the gap lies: places, the regimes in which it stands out, and what relations fitted alone leave."""

    locations: tuple[FaultLocation, ...] = ()
    regimes: tuple[Regime, ...] = ()
    maps: tuple[Map, ...] = ()


@dataclass(frozen=True)
class Partial:
    """The causes that come nearest where nothing explains the gap, and their share of it."""

    effects: tuple[str, ...]
    share: float


def probabilities(logs: Mapping[tuple[str, ...], float], effects: Iterable[str]) -> dict[str, float]:
    """Return for every effect the probability that it is present, from log evidences.

    Effects that were screened away have no hypothesis and get 0; the numbers need not sum to 1.
    """
    weights = weights_of(logs)
    return {e: sum(w for ids, w in weights.items() if e in ids) for e in effects}


def weights_of(logs: Mapping[tuple[str, ...], float]) -> dict[tuple[str, ...], float]:
    """Return the probability of every hypothesis, from log evidences."""
    return dict(zip(logs, softmax(list(logs.values())).tolist(), strict=True))


def competing_hypotheses(
    fits: Fits, best: Fit, logs: Mapping[tuple[str, ...], float], not_excluded: tuple[Fit, ...] = ()
) -> tuple[Fit, ...]:
    """Return the best hypothesis, those held open, and those the evidence cannot rule out.

    One that adds a cause counts where the evidence for that is neither negligible nor decisive.
    """
    if not best.ids:
        return (best,)
    config = best.problem.method.competing
    top = logs[best.ids]
    near = [fits[ids] for ids in sorted(logs, key=lambda i: -logs[i]) if logs[ids] > top - config.odds]
    in_play: list[Fit] = [best, *not_excluded]
    for result in near:
        ids = set(result.ids)
        # A larger set of causes holds the evidence of the smaller one and says nothing new.
        if ids and not any(ids >= set(other.ids) for other in in_play):
            in_play.append(result)
    max_causes = max(config.max_causes, len(best.ids) + 1)
    # Hypotheses with one cause more that can be neither named nor left out.
    best_ids = set(best.ids)
    larger = [f for ids, f in fits.items() if set(ids) > best_ids and len(ids) == len(best_ids) + 1]
    ahead = {f.ids: exact_log_evidence(f) - exact_log_evidence(best) for f in larger}
    min_log = max(ahead.values(), default=0.0) - config.odds
    # Another form of one cause may be two in the catalogue's equations: a joint is frame and toe.
    is_in_other_form = any(form.effect is e for e in best.effects for form in best.problem.model.forms_of(e.id))
    within = config.odds if is_in_other_form else config.added
    max_z = max(best.problem.method.structure.structured_z, config.structure_left * structure(best).z)
    for result in sorted(larger, key=lambda f: -ahead[f.ids]):
        gain, behind = ahead[result.ids], top - logs[result.ids]
        is_near = behind < within or (behind < config.negligible and gain > config.exact)
        if gain < min_log or not is_near or structure(result).z >= max_z or any(result.ids == f.ids for f in in_play):
            continue
        if len({*result.ids}.union(*(other.ids for other in in_play))) <= max_causes:
            in_play.append(result)
    return tuple(in_play[: config.max_hypotheses])


def confused_pairs(group: tuple[Fit, ...]) -> list[list[str]]:
    """Return the pairs of effects that stand for each other in rival hypotheses.

    A cause beside another rival's stands for what the equation of the largest of those leaves.
    """
    best = set(group[0].ids)
    pairs: list[list[str]] = []
    for other in group[1:]:
        of_best = sorted(best - set(other.ids))
        of_other = sorted(set(other.ids) - best)
        shared = sorted(best & set(other.ids), key=lambda i: -energy(signature(group[0], i)))
        crossed_pairs = [[a, b] for a in of_best for b in of_other] or [
            [shared[0], extra] for extra in (*of_best, *of_other)
        ]
        pairs += [pair for pair in crossed_pairs if pair not in pairs]
    return pairs


def hidden_fraction(result: Fit, effect_id: str) -> float:
    """Return which share of an effect's signature, at its size, the refitted base would swallow."""
    change = signature(result, effect_id)
    size = energy(change)
    if size <= 0.0:
        return 1.0
    # To first order: a full refit for each effect would take as long as the diagnosis.
    visible = Tangent(result, base_only=True).visible(change)
    return float(np.clip(1.0 - energy(visible) / size, 0.0, 1.0))


@dataclass(frozen=True)
class Consistency:
    """How a cause stands to the rest that its hypothesis leaves.

    Args:
        energy_share: share of the cause in the energy of cause and rest, of what no other fitted parameter imitates.
        disagreement: root mean square by which the parts of all runs ask for another size, relative to the fitted one.
        cancelled: share of what the base leaves of its signature that the other causes cancel: two that imitate a
            third by their difference cancel nearly all.
        is_on_bound: whether a parameter ends on a bound: its law wants to be another one.
        bent: share of the rest that the cause takes where its size may follow the state: then a law that resembles
            this one may be at work.
        kin: share of its signature that another law of the list takes: one that resembles it was tried, and lost.
    """

    energy_share: float
    disagreement: float
    cancelled: float = 0.0
    is_on_bound: bool = False
    bent: float = 0.0
    kin: float = 0.0

    def genuine_chance(self, config: PresenceConfig) -> float:
        """Return how likely a cause that stands so to a rest is there, and imitates nothing."""
        apart = np.log(min(max(self.disagreement, 1e-3), 1e300) / config.disagreement)
        odds = logit(np.clip(self.energy_share, 0.0, 1.0))
        cancelled = np.log1p(-min(self.cancelled, 1.0 - 1e-9))
        carries = config.of_share * (odds - config.share_odds) - config.of_disagreement * apart
        # Beside what a cause takes stands what it leaves: where that has its own shape, its law is another one.
        # A law that stays beside a cause and cancels it has not lost.
        has_lost = self.kin >= config.tried > self.cancelled
        fits = config.bent_odds - config.of_bent * self.bent * (not has_lost) - config.of_bound * self.is_on_bound
        return float(expit(carries + config.of_cancelled * cancelled) * expit(fits))


def signature(result: Fit, effect_id: str) -> Array:
    """Return (samples,) change of the whitened prediction when an effect of a fit is switched off."""
    smaller, is_retained = result.hypothesis.without(effect_id)
    without = result.problem.predict(smaller, result.coordinates[is_retained])
    return result.problem.whitened(result.predicted - without)


def rest_energy(result: Fit, noise_chance: float) -> float:
    """Return how much of χ² is a rest that is no noise; 0 where noise leaves as much often enough.

    Args:
        noise_chance: how likely noise alone leaves as much, a p-value.
    """
    if noise_chance > result.problem.method.noise_test.chance:
        return 0.0
    count, residual = result.problem.count, structure(result)
    # A noise level read off the residual itself holds a part of the rest: at least two standard errors of χ².
    min_energy = 2.0 * float(np.sqrt(2.0 * count))
    return max(energy(result.residual) - count, residual.rms**2 * count if residual.is_significant else 0.0, min_energy)


def consistency_of(
    result: Fit, effect_id: str, rest: float, laws: Iterable[Array] = (), without: Fit | None = None
) -> Consistency:
    """Return how a cause of a fit stands to the rest that the fit leaves, in units of χ².

    Args:
        laws: what the other laws of the list do to the base, under several shapes.
        without: the fit without the cause; None where there is none.
    """
    config, change, at = result.problem.method.presence, signature(result, effect_id), result.hypothesis.slices
    # Of its signature what no other fitted parameter imitates.
    others = np.delete(result.jacobian, range(at[effect_id].start, at[effect_id].stop), axis=0)
    basis = orthonormal(others, 1e-10)
    linear = np.asarray(change - (basis @ change) @ basis)
    linear_energy = energy(linear)
    visible, visible_energy = linear, linear_energy
    if without is not None:
        # What a run has of its own ends at a bound; a base that moves along may stay within it.
        refitted = result.problem.whitened(result.predicted - without.predicted)
        if energy(refitted) < linear_energy:
            visible, visible_energy = refitted, energy(refitted)
    if visible_energy <= 0.0:
        return Consistency(0.0, np.inf)
    pulled = 0.0
    for block in result.problem.blocks:
        for part in np.array_split(np.arange(block.rows.start, block.rows.stop), config.parts):
            part_energy = energy(visible[part])
            # A part where the cause does not act asks for nothing.
            if part_energy > config.acts * visible_energy:
                pulled += float(visible[part] @ result.residual[part]) ** 2 / part_energy
    base = Tangent(result, base_only=True)
    own = base.visible(change)
    beyond_base = energy(own)
    cancelled = float(np.clip(1.0 - linear_energy / beyond_base, 0.0, 1.0)) if beyond_base > 0.0 else 0.0
    is_on_bound = any(name.startswith(f"{effect_id}.") for name in bounds_reached(result))
    bent = bent_share(result, change, rest) if config.of_bent and rest > 0.0 else 0.0
    share, disagreement = visible_energy / (visible_energy + rest), float(np.sqrt(pulled / visible_energy))
    rows = [row for row in map(base.visible, laws) if energy(row) > 0.0]
    kin = max((float(own @ row) ** 2 / (beyond_base * energy(row)) for row in rows), default=0.0)
    return Consistency(share, disagreement, cancelled, is_on_bound, bent, kin)


def bent_share(result: Fit, change: Array, rest: float) -> float:
    """Return which share of a rest a signature takes whose size follows the state of the mechanism."""
    rows = [
        change * np.append(state, np.zeros(len(change) - len(state))) for state in result.problem.model.states(result)
    ]
    visible = projected(rows, result.jacobian)
    # Each direction takes 1 off χ² by chance.
    taken = float(np.sum((visible @ result.residual) ** 2)) - len(visible) if len(visible) else 0.0
    return float(np.clip(taken / rest, 0.0, 1.0))


def list_completeness(noise_chance: float, rest_share: float, has_unlisted: bool, config: PresenceConfig) -> float:
    """Return how likely nothing unmodelled is left.

    Args:
        noise_chance: how likely noise alone leaves as much, a p-value.
        rest_share: share of the gap that is left beside the causes.
        has_unlisted: whether a departure outside the list explains more than the list does.
    """
    if has_unlisted:
        return config.unlisted
    # The most a p-value can say for a rest: Bayes factor −e·p·ln p (Sellke, Bayarri and Berger 2001).
    p = min(max(noise_chance, 1e-300), float(np.exp(-1.0)))
    odds = config.complete_odds * -float(np.e * p * np.log(p))
    by_noise = odds / (1.0 + odds)
    # Another law of the same cause leaves a small part of a large gap.
    by_share = 1.0 / (1.0 + (max(rest_share, 0.0) / config.half_share) ** 2)
    return max(by_noise, by_share * config.open_law)


def estimates_of(result: Fit, effect_id: str) -> dict[str, ParameterEstimate]:
    """Return value and 90 % interval of an effect's parameters; none where the fit lacks it."""
    effect = next((e for e in result.effects if e.id == effect_id), None)
    if effect is None:
        return {}
    at, out = result.hypothesis.slices[effect_id], {}
    margins = NORMAL_90 * np.sqrt(np.maximum(np.diag(result.covariance), 0.0))[at]
    for parameter, x, margin in zip(effect.parameters, result.coordinates[at], margins, strict=True):
        p = result.problem.scale.sized(parameter)
        ends = sorted(from_fit(p, float(x + side * margin)) for side in (-1.0, 1.0))
        three = (from_fit(p, float(x)), *ends)
        value, low, high = (float(np.nan_to_num(v, posinf=p.high, neginf=p.low)) for v in three)
        out[p.name] = ParameterEstimate(value, low, high, p.unit)
    return out


def bounds_reached(result: Fit) -> dict[str, float]:
    """Return the parameters that a fit left on a bound, with values; a cause's as `cause.parameter`.

    A bound that switches a cause off is none.
    """
    base, rows = result.hypothesis.split(result.coordinates)
    free = [p for p, is_free in zip(result.hypothesis.of_all, result.problem.is_free, strict=True) if is_free]
    pairs = [(p.name, p, v) for p, v in zip(result.hypothesis.of_all, base, strict=True) if p in free]
    for effect, values in zip(result.effects, rows, strict=True):
        pairs += [(f"{effect.id}.{p.name}", p, v) for p, v in zip(effect.parameters, values, strict=True)]
    reached = {}
    for name, parameter, value in pairs:
        sized = result.problem.scale.sized(parameter)
        ends = [
            end for end in (sized.low, sized.high) if np.isfinite(end) and end != sized.neutral and not sized.is_fixed
        ]
        if any(math.isclose(value, end, rel_tol=1e-6, abs_tol=1e-9 * abs(sized.usual)) for end in ends):
            reached[name] = value
    return reached


def fault_locations(
    causes: Sequence[RankedCause], channel: str, regime: Reason, detail: Callable[[str], Reason]
) -> list[FaultLocation]:
    """Return the places of named causes, each with its part of what all of them take."""
    total = sum(c.shrink or 0.0 for c in causes) or 1.0
    return [FaultLocation(c.stage, channel, regime, (c.shrink or 0.0) / total, detail(c.effect)) for c in causes]


def with_residual_location(locations: Sequence[FaultLocation], rest: FaultLocation) -> list[FaultLocation]:
    """Return the places of causes, scaled by what they take, with the place of a rest."""
    rest = replace(rest, detail=reason("gap.seen.rest", share=rest.share))
    return [*(replace(location, share=(1.0 - rest.share) * location.share) for location in locations), rest]


def regime_locations(stage: str, regimes: Sequence[Regime], code: str) -> list[FaultLocation]:
    """Return the first four regimes in which the gap stands out as places at a stage."""
    return [
        FaultLocation(stage, r.channel, r.name, r.share, reason(code, share=r.share, lift=r.lift)) for r in regimes[:4]
    ]


def partial_of(fits: Fits, best: Fit) -> Partial | None:
    """Return the best set and its share of the gap; what comes nearest where no set stands."""
    closest = best if best.ids else nearest(fits)
    share = float(np.clip(share_of_gap(fits[()], closest), 0.0, 1.0))
    return Partial(closest.ids, share) if closest.ids and share > 0.0 else None


def nearest(fits: Fits) -> Fit:
    """Return the simplest hypothesis that takes nearly the most of the gap away."""
    base = fits[()]
    enough = max(share_of_gap(base, f) for f in fits.values()) - base.problem.method.verdict.near_share
    near = [result for result in fits.values() if share_of_gap(base, result) >= enough]
    return min(near, key=lambda result: (len(result.ids), result.chi2))


def ranked_causes(
    fits: Fits,
    best: Fit,
    effects: Sequence[Effect],
    reported: tuple[Fit, ...],
    chances: dict[str, float],
    explained_fraction: float,
) -> tuple[RankedCause, ...]:
    """Return every effect with how it stands, the likeliest first.

    Args:
        fits: of all hypotheses, by their causes.
        reported: where parameters are taken from, the first that has them; else from the effect alone.
        explained_fraction: share of the gap that goes on samples held back, split among the best causes.
    """
    ids, base = best.ids, fits[()]
    excess = max(base.chi2 - base.problem.count, 0.0)
    one_less = {i: fits.get(tuple(j for j in ids if j != i)) for i in ids}
    # The explained χ² is split among several causes: the mean of adding each first and last.
    worth = dict.fromkeys(ids, 1.0)
    for effect_id in ids if len(ids) > 1 else ():
        alone, rest = fits.get((effect_id,)), one_less[effect_id]
        first = base.chi2 - alone.chi2 if alone else 0.0
        last = rest.chi2 - best.chi2 if rest else 0.0
        worth[effect_id] = max(0.5 * (first + last), 0.0)
    total = sum(worth.values()) or 1.0
    forms = {e.id: form_of(best, e) for e in best.effects}

    def share_of(better: Fit | None, worse: Fit | None) -> float | None:
        if better is None or worse is None or excess <= 0.0:
            return None
        return float(np.clip((worse.chi2 - better.chi2) / excess, 0.0, 1.0))

    def cause(effect: Effect) -> RankedCause:
        result = next((f for f in reported if effect.id in f.ids), fits.get((effect.id,)))
        return RankedCause(
            effect.id,
            effect.stage,
            chances[effect.id],
            worth[effect.id] / total * explained_fraction if effect.id in worth else None,
            estimates_of(result, effect.id) if result is not None else {},
            forms.get(effect.id, ""),
            alone=share_of(fits.get((effect.id,)), base),
            added=share_of(best, one_less.get(effect.id)),
        )

    return tuple(sorted(map(cause, effects), key=lambda c: (-c.probability, -(c.shrink or 0.0))))


def in_catalogue_form(result: Fit) -> Fit:
    """Return the fit with every cause by the catalogue's equation; itself where it already is."""
    listed = {e.id: e for e in result.problem.model.candidates}
    effects = tuple(listed[e.id] if form_of(result, e) else e for e in result.effects)
    if effects == result.effects:
        return result
    rows = []
    for effect, fitted, values in zip(effects, result.effects, result.effect_values, strict=True):
        values_by_name = {p.name: v for p, v in zip(fitted.parameters, values, strict=True)}
        rows.append([values_by_name.get(p.name, p.usual) for p in effect.parameters])
    start = np.append(result.coordinates[result.hypothesis.of_base], start_coordinates(effects, rows))
    return fit(result.problem, replace(result.hypothesis, effects=effects), start, steps=40)


def with_constants(result: Fit) -> Fit:
    """Return the fit with the constants of every form set to one value for all runs.

    A fit reads them off each run: its largest force, of which strokes are shares. A twin has one number,
    the largest of the runs. Base and causes are refitted with it.
    """
    effects = result.effects
    if not any(_is_open(effect) for effect in effects):
        return result
    maxima = {effect.id: dict.fromkeys((name for name, _ in effect.constants), 0.0) for effect in effects}

    def record_maxima(effect: Effect) -> Effect:
        largest = maxima[effect.id]

        def step(flow: Flow, values: Sequence[float], state: Memory) -> None:
            effect.step(flow, values, state)
            largest.update({name: max(maximum, float(state[name][0])) for name, maximum in largest.items()})

        return replace(effect, step=step)

    def fix_maxima(effect: Effect) -> Effect:
        def step(flow: Flow, parameters: Sequence[float], state: Memory) -> None:
            effect.step(flow, (*parameters, *maxima[effect.id].values()), state)

        return replace(effect, step=step, constants=tuple(maxima[effect.id].items()))

    open_ = tuple(record_maxima(e) if _is_open(e) else e for e in effects)
    result.problem.bare.predict(replace(result.hypothesis, effects=open_), result.coordinates)
    closed = tuple(fix_maxima(e) if _is_open(e) else e for e in effects)
    return fit(result.problem, replace(result.hypothesis, effects=closed), result.coordinates, steps=40)


def _is_open(effect: Effect) -> bool:
    return any(not np.isfinite(value) for _, value in effect.constants)
