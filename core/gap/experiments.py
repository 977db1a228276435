"""What these runs can tell, seen from the fitted base, and which run would tell the rest or tells rivals apart.

Everything is first order: of the change a parameter makes by its usual size, the part that neither
the others nor what each run may have of its own can imitate, in standard deviations of the noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from softcal.core.gap.case import MenuEntry, Run
from softcal.core.gap.fit import fit, nuisance_rows
from softcal.core.gap.hypothesis import fit_scale, start_coordinates
from softcal.core.gap.linear import energy, gram, scaled_inverse
from softcal.core.gap.method import IdentifiabilityConfig
from softcal.core.gap.model import Fit, Fits, Problem
from softcal.core.messages.reason import Reason, reason, several, with_sentences
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect


@dataclass(frozen=True)
class NextExperiment:
    """The proposed run, and by how many standard deviations refitted rivals stand apart over it."""

    profile: str
    why: Reason
    separation_sigma: float = 0.0  # noqa: V107
    minutes: float = 0.0

    def record(self) -> dict[str, object]:
        return with_sentences(vars(self), "why")


def propose_experiment(
    entries: Sequence[MenuEntry], competing: Sequence[Fit], first_name: Reason | None = None
) -> NextExperiment:
    """Return the entry that tells most rivals from the first, and does so best per minute.

    Args:
        first_name: what the first is called, where it is no set of causes.
    """
    first, others, enough = competing[0], competing[1:], competing[0].problem.method.telling.enough_sigma
    candidates: list[tuple[int, float, float, MenuEntry]] = []
    # A larger hypothesis can take the shape of a smaller one.
    pairs = [[(a, b) for a, b in ((first, other), (other, first)) if not set(a.ids) > set(b.ids)] for other in others]
    for experiment in entries:
        distances = [min(_distance(a, b, experiment.run) for a, b in both) for both in pairs]
        parted = [distance for distance in distances if distance >= enough]
        min_separation = min(parted, default=0.0)
        candidates.append(
            (len(parted), min(min_separation, 10 * enough) / experiment.minutes, min_separation, experiment)
        )
    count, _, distance, experiment = max(candidates, key=lambda entry: entry[:2])
    causes = causes_of(competing, first_name)
    if count == 0:
        remedies = dict.fromkeys(e.signs.remedy for f in competing for e in f.effects if e.signs.remedy)
        remedy = several([Reason.parse(one) for one in remedies] or [Reason("gap.remedy.usual")])
        return NextExperiment("none", reason("gap.next.inseparable", causes=causes, remedy=remedy))
    cause = reason("gap.next.separates", causes=causes, distance=distance, minutes=experiment.minutes)
    if count < len(others):
        cause = reason("gap.next.separates_most", **cause.values, others=len(others) - count)
    return NextExperiment(experiment.name, cause, distance, experiment.minutes)


def propose_for_unmodelled(
    entries: Sequence[MenuEntry], fits: Fits, rest: Fit, causes: Sequence[str]
) -> NextExperiment | None:
    """Return the entry that tells a rest, by its own law, from the causes nearest to it; None where none does.

    Args:
        rest: a hypothesis of the causes `causes` and of what describes the rest.
    """
    max_count = rest.problem.method.competing.max_hypotheses
    larger = [f for f in fits.values() if set(f.ids) > set(causes) and len(f.ids) == len(causes) + 1]
    nearest = sorted(larger, key=lambda result: result.chi2)[:max_count]
    proposed = propose_experiment(entries, (rest, *nearest), Reason("gap.rest")) if entries and nearest else None
    return None if proposed is None or proposed.profile == "none" else proposed


def causes_of(competing: Sequence[Fit], first_name: Reason | None = None) -> Reason:
    """Return the causes of hypotheses in words, those of one together."""
    names = [together(f.ids, "gap.together") for f in competing]
    return several(names if first_name is None else [first_name, *names[1:]], "gap.both")


def together(effects: Sequence[str], code: str) -> Reason:
    """Return identifiers of effects as one reason; `code` says how they are joined."""
    return several([reason("gap.effect", effect=effect) for effect in effects], code)


def _distance(current: Fit, other: Fit, run: Run) -> float:
    """Return how far `other` stays from `current` on a new run once `current` is refitted to it too."""
    problem = current.problem.of_run(run)
    hypothesis = current.hypothesis.without_episodes()
    predicted = problem.predict(other.hypothesis.without_episodes(), other.coordinates)
    parted = problem.whitened(predicted - problem.predict(hypothesis, current.coordinates))
    if not np.all(np.isfinite(parted)):
        # A simulator that fails there tells nothing.
        return 0.0
    jacobian = fit(problem, hypothesis, current.coordinates, steps=0).jacobian
    old = gram(current.jacobian)
    free = np.flatnonzero(np.diag(old) > 0)
    normal = old[np.ix_(free, free)] + gram(jacobian[free])
    slope = jacobian[free] @ parted
    residual_energy = energy(parted) - float(slope @ np.linalg.lstsq(normal, slope, rcond=None)[0])
    return float(np.sqrt(max(residual_energy, 0.0)))


@dataclass(frozen=True)
class ParameterIdentifiability:
    """How well these runs tell one parameter of the base, or one cause.

    Args:
        sigma: standard deviations by which a change of the usual size shows.
        hidden: share of that change that the base takes.
        own: share of the rest that what each run may have of its own takes.
        offset: the offset that does, as `delay of y`; empty where none does.
        beside: other parameters of the base that it is traded against.
        by: runs that could be made and would tell it, the quickest first.
        is_named: whether a search named it: then it shows here, though a change of the usual size would not.
    """

    name: str
    is_base: bool
    sigma: float
    hidden: float
    own: float = 0.0
    offset: str = ""
    beside: tuple[str, ...] = ()
    by: tuple[str, ...] = ()
    is_named: bool = False
    config: IdentifiabilityConfig = field(default=IdentifiabilityConfig(), repr=False)

    @property
    def is_run_nuisance(self) -> bool:
        """Whether runs may have of their own what this cause would do."""
        return bool(self.offset)

    @property
    def is_identifiable(self) -> bool:
        """Whether it shows, or a change of the usual size would."""
        return self.is_named or (self.sigma >= self.config.sigma and not self.is_run_nuisance)

    def record(self) -> dict[str, object]:
        plain = {name: value for name, value in vars(self).items() if name not in ("config", "is_named")}
        return plain | {"beside": list(self.beside), "by": list(self.by), "is_told": self.is_identifiable}


@dataclass(frozen=True)
class Identifiability:
    """What the runs tell of every base parameter and cause, and causes that are one to them."""

    every: tuple[ParameterIdentifiability, ...]
    alike: tuple[tuple[str, str], ...] = ()

    def __getitem__(self, name: str) -> ParameterIdentifiability:
        return next(one for one in self.every if one.name == name)

    @property
    def unidentifiable(self) -> tuple[ParameterIdentifiability, ...]:
        """What these runs do not tell."""
        return tuple(one for one in self.every if not one.is_identifiable)

    def naming(self, causes: Sequence[str]) -> "Identifiability":
        """Return the same where a search has named these causes."""
        return replace(self, every=tuple(replace(one, is_named=one.name in causes) for one in self.every))

    def record(self) -> dict[str, object]:
        return {
            "base": {one.name: one.record() for one in self.every if one.is_base},
            "causes": {one.name: one.record() for one in self.every if not one.is_base},
            "alike": [list(pair) for pair in self.alike],
            "untold": [one.to_json() for one in reasons(self)],
        }


def identifiability(base: Fit, effects: Sequence[Effect], menu: Sequence[MenuEntry] = ()) -> Identifiability:
    """Return what the runs of a base fit tell of it and of effects.

    Args:
        menu: runs that could be made; each is looked at for what these do not tell.
    """
    # What has no place in time before it is searched shows nothing yet.
    effects = [effect for effect in effects if not effect.is_episodic]
    rows = _Rows.from_fit(base, base.problem, effects)
    every = [*_identify_base(rows, base), *_identify_causes(rows, base, effects)]
    for entry in sorted(menu, key=lambda entry: entry.minutes):
        missing = [one for one in every if not one.is_identifiable]
        if not missing:
            break
        also = [e for e in effects if any(one.name == e.id for one in missing)]
        extended = rows.with_run(_Rows.from_fit(base, base.problem.of_run(entry.run), also))
        names = {one.name for one in missing if extended.shows(one.name)}
        every = [replace(one, by=(*one.by, entry.name)) if one.name in names else one for one in every]
    pairs = combinations([e.id for e in effects], 2)
    alike = [pair for pair in pairs if abs(rows.cosine(*map(rows.cause, pair))) > base.problem.method.telling.alike]
    return Identifiability(tuple(every), tuple(alike))


def reasons(identifiable: Identifiability) -> list[Reason]:
    """Return why runs do not tell what they do not tell, a reason for each."""
    pairs = [[reason("gap.effect", effect=effect) for effect in pair] for pair in identifiable.alike]
    return [
        *map(explain_unidentifiable, identifiable.unidentifiable),
        *(reason("gap.told.alike", one=a, other=b) for a, b in pairs),
    ]


def explain_unidentifiable(one: ParameterIdentifiability) -> Reason:
    """Return why runs do not tell a parameter or a cause, and which run would."""
    runs = [reason("gap.run", profile=name) for name in one.by]
    cure = reason("gap.told.run", runs=several(runs, "gap.list")) if runs else Reason("gap.told.no_run")
    name = Reason.parse(one.name) if one.is_base else reason("gap.effect", effect=one.name)
    if one.is_run_nuisance:
        return reason("gap.told.own", name=name, offset=one.offset, cure=cure)
    if one.beside:
        beside = several([Reason.parse(other) for other in one.beside], "gap.both")
        return reason("gap.told.beside", name=name, beside=beside, cure=cure)
    if one.sigma < one.config.nothing:
        return reason("gap.told.never", name=name, cure=cure)
    return reason("gap.told.small", name=name, sigma=one.sigma, cure=cure)


@dataclass(frozen=True, eq=False)
class _Rows:
    """Products of rows over some runs: of the base, of what runs have of their own, and of causes.

    Args:
        base: names of the base parameters with a row.
        nuisance: which rows belong to which kind of offset, (k,) numbers of kinds.
        causes: names of the causes, at the usual and at a smaller size.
        gram: (rows, rows), base, own and causes in this order.
    """

    base: tuple[str, ...]
    nuisance: tuple[int, ...]
    causes: tuple[str, ...]
    gram: Array = field(repr=False)
    config: IdentifiabilityConfig
    _inverses: dict[tuple[int, ...], Array] = field(default_factory=dict, repr=False)

    @classmethod
    def from_fit(cls, result: Fit, problem: Problem, effects: Sequence[Effect]) -> "_Rows":
        bare, config = fit(problem.bare, result.hypothesis, result.coordinates, steps=0), problem.method.telling
        if not np.all(np.isfinite(bare.predicted)):
            return cls((), (), (), np.zeros((0, 0)), config)
        scales = [fit_scale(problem.scale.sized(p)) for p in result.hypothesis.of_all]
        rows = [scale * row for scale, row in zip(scales, bare.jacobian, strict=True)]
        names = [p.name for p in result.hypothesis.of_all]
        telling = [k for k, row in enumerate(rows) if row.any()]
        nuisance: list[Array] = []
        kinds: tuple[int, ...] = ()
        if len(problem.largest_offsets):
            nuisance, kinds = nuisance_rows(
                problem, problem.directions(result.hypothesis, bare.coordinates, bare.predicted, {})
            )
        causes = {e.id: _changes(bare, e) for e in effects}
        every = [
            *(rows[k] for k in telling),
            *map(problem.whitened, nuisance),
            *(row for pair in causes.values() for row in pair),
        ]
        stacked = np.array(every).reshape(len(every), len(bare.residual))
        return cls(tuple(names[k] for k in telling), kinds, tuple(causes), stacked @ stacked.T, config)

    def with_run(self, new: "_Rows") -> "_Rows":
        """Return the rows over these runs and a new one, which has offsets of its own."""
        base = tuple(dict.fromkeys((*self.base, *new.base)))
        causes = tuple(c for c in self.causes if c in new.causes)
        nuisance = (*self.nuisance, *new.nuisance)
        size = len(base) + len(nuisance) + 2 * len(causes)
        gram = np.zeros((size, size))
        for part, skipped in ((self, 0), (new, len(self.nuisance))):
            at = [base.index(name) for name in part.base]
            at += [len(base) + skipped + k for k in range(len(part.nuisance))]
            source_rows = list(range(len(part.base) + len(part.nuisance)))
            for k, name in enumerate(causes):
                at += [len(base) + len(nuisance) + 2 * k + i for i in (0, 1)]
                source_rows += [part.cause(name) + i for i in (0, 1)]
            gram[np.ix_(at, at)] += part.gram[np.ix_(source_rows, source_rows)]
        return _Rows(base, nuisance, causes, gram, self.config)

    def cause(self, name: str) -> int:
        return len(self.base) + len(self.nuisance) + 2 * self.causes.index(name)

    @property
    def of_base(self) -> list[int]:
        return list(range(len(self.base)))

    @property
    def base_and_nuisance(self) -> list[int]:
        """Rows of base and offsets."""
        return list(range(len(self.base) + len(self.nuisance)))

    def residual_energy(self, row: int, others: Sequence[int]) -> float:
        """Return the energy of a row that others do not imitate."""
        return max(float(self.gram[row, row]) - float(self.gram[row, others] @ self.weights(row, others)), 0.0)

    def weights(self, row: int, others: Sequence[int]) -> Array:
        """Return by what others imitate a row best."""
        others = tuple(others)
        if others not in self._inverses:
            self._inverses[others] = scaled_inverse(self.gram[np.ix_(others, others)])
        return np.asarray(self._inverses[others] @ self.gram[list(others), row])

    def shows(self, name: str) -> bool:
        """Whether a base parameter or a cause shows by enough, and is no offset."""
        if name in self.base:
            return self.sigma_of_base(self.base.index(name)) >= self.config.sigma
        if name not in self.causes:
            return False
        at = self.cause(name)
        return (
            self.nuisance_share(at) < self.config.offset_share
            and self.residual_energy(at, self.base_and_nuisance) >= self.config.sigma**2
        )

    def sigma_of_base(self, k: int) -> float:
        """Return by how many σ a base parameter shows, 0 where others imitate it to rounding."""
        residual = self.residual_energy(k, [i for i in self.base_and_nuisance if i != k])
        return float(np.sqrt(residual)) if residual > self.config.min_visible * float(self.gram[k, k]) else 0.0

    def nuisance_share(self, cause: int, kind: int | None = None) -> float:
        """Return which share of what the base leaves of a cause, at either size, offsets take."""
        nuisance = [len(self.base) + k for k, from_fit in enumerate(self.nuisance) if kind in (None, from_fit)]
        shares = [0.0]
        for row in (cause, cause + 1):
            visible = self.residual_energy(row, self.of_base)
            if visible > self.config.min_visible * float(self.gram[row, row]):
                shares.append(1.0 - self.residual_energy(row, [*self.of_base, *nuisance]) / visible)
        return max(shares)

    def cosine(self, one: int, other: int) -> float:
        """Return how much alike two rows are beyond what base and offsets imitate."""
        others = self.base_and_nuisance
        residuals = [self.residual_energy(row, others) for row in (one, other)]
        if min(residuals) < self.config.sigma**2:
            return 0.0
        shared = float(self.gram[one, other] - self.gram[one, others] @ self.weights(other, others))
        return shared / float(np.sqrt(residuals[0] * residuals[1]))


def _changes(bare: Fit, effect: Effect) -> tuple[Array, Array]:
    sized = [bare.problem.scale.sized(p) for p in effect.parameters]
    usual = [p.usual for p in sized]
    smaller, neutral = usual[0], sized[0].neutral
    if neutral is not None and np.isfinite(neutral):
        # A level that cuts off is the smaller the farther it lies.
        smaller = neutral + bare.problem.method.telling.smaller * (usual[0] - neutral)
    rows = []
    for values in (usual, [smaller, *usual[1:]]):
        start = np.append(bare.coordinates, start_coordinates([effect], [values]))
        change = bare.problem.predict(bare.hypothesis.adding(effect), start) - bare.predicted
        row = bare.problem.whitened(change if np.all(np.isfinite(change)) else np.zeros(len(change)))
        rows.append(row)
    return rows[0], rows[1]


def _identify_base(rows: _Rows, base: Fit) -> list[ParameterIdentifiability]:
    config, out = rows.config, []
    for p in base.hypothesis.of_all:
        if p.name not in rows.base:
            out.append(ParameterIdentifiability(p.name, True, 0.0, 0.0, config=config))
            continue
        k = rows.base.index(p.name)
        others = [i for i in range(len(rows.base)) if i != k]
        weights = rows.weights(k, others)
        traded = rows.gram[np.ix_(others, others)].diagonal() * weights**2
        energy_of_row = float(rows.gram[k, k])
        sigma = rows.sigma_of_base(k)
        is_traded = traded > config.traded * energy_of_row
        others_traded = tuple(rows.base[i] for i, is_in in zip(others, is_traded, strict=True) if is_in)
        hidden = float(np.clip(1.0 - rows.residual_energy(k, others) / energy_of_row, 0.0, 1.0))
        others_traded = others_traded if sigma < config.sigma else ()
        out.append(ParameterIdentifiability(p.name, True, sigma, hidden, beside=others_traded, config=config))
    return out


def _identify_causes(rows: _Rows, base: Fit, effects: Sequence[Effect]) -> list[ParameterIdentifiability]:
    config, offsets = rows.config, base.problem.model.offset_names
    largest = base.problem.largest_offsets
    # Of each kind of offset, whether it stands on its bound in most runs.
    sizes = np.array(list(base.problem.offset_sizes(base.hypothesis, base.coordinates).values()))
    is_full = np.zeros(len(largest), dtype=np.bool_)
    if sizes.size:
        is_full = np.mean(np.abs(sizes) >= config.on_bound * largest, axis=0) > 0.5
    out = []
    for effect in effects:
        at = rows.cause(effect.id)
        energy_of_row, visible = float(rows.gram[at, at]), rows.residual_energy(at, rows.of_base)
        share = rows.nuisance_share(at)
        sigma = float(np.sqrt(rows.residual_energy(at, rows.base_and_nuisance)))
        kind = max(range(len(offsets)), key=lambda k: rows.nuisance_share(at, k), default=None)
        # A delay that all runs share, beyond the largest that each may have, is no longer theirs.
        is_nuisance = kind is not None and share >= config.offset_share and not is_full[kind]
        offset = offsets[kind] if is_nuisance and kind is not None else ""
        hidden = float(np.clip(1.0 - visible / energy_of_row, 0.0, 1.0)) if energy_of_row > 0.0 else 1.0
        out.append(ParameterIdentifiability(effect.id, False, sigma, hidden, share, offset, config=config))
    return out
