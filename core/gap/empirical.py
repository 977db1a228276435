"""The learned residual: a few empirical terms that describe what no named cause explains.

Terms are chosen forward, each with a refit of base and causes, by what runs and quarters of runs
that were held back say. The choice is held back as well: for every run that scores the result,
terms are chosen anew without it (nested cross-validation; Varma and Simon, BMC Bioinf. 2006).
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar, Generic, Protocol, TypeAlias, TypeVar

import numpy as np
from scipy.stats import t as student

from softcal.core.gap.fit import fit, rows_of_runs
from softcal.core.gap.hypothesis import start_coordinates
from softcal.core.gap.linear import energy
from softcal.core.gap.method import GapMethod
from softcal.core.gap.model import Fit, Problem
from softcal.core.gap.residual import ExplainedFraction
from softcal.core.recording import Array
from softcal.core.twin.effects import Effect


class Term(Protocol):
    """A term of a model: place += coefficient · variable."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def place(self) -> str: ...

    @property
    def variable(self) -> str: ...

    @property
    def coefficient(self) -> float: ...

    @property
    def unit(self) -> str: ...

    @property
    def formula(self) -> str: ...

    @property
    def effect(self) -> Effect: ...


T = TypeVar("T", bound=Term)

Cell: TypeAlias = tuple[int, int]
"""A run, and a quarter of it."""


@dataclass(frozen=True)
class LearnedTerm(Generic[T]):
    """A term, how well it is known, and which share of the choices without a part took it too."""

    term: T
    standard_error: float
    chosen: float


@dataclass(frozen=True, eq=False)
class LearnedResidual(Generic[T]):
    """What is left of a gap, described by terms, the largest first.

    Args:
        explained_fraction: of the gap of the base, by causes and terms together, on runs that neither saw.
        without: the same by the causes alone.
    """

    terms: tuple[LearnedTerm[T], ...]
    explained_fraction: ExplainedFraction
    without: float
    fit: Fit

    def record(self) -> dict[str, object]:
        """Return what the report of the twin and of a simulator say of it alike."""
        return {
            "kind": "empirical",
            "formula": [one.term.formula for one in self.terms],
            "terms": [
                {
                    "place": one.term.place,
                    "variable": one.term.variable,
                    "coefficient": one.term.coefficient,
                    "standard_error": one.standard_error,
                    "unit": one.term.unit,
                    "chosen": one.chosen,
                }
                for one in self.terms
            ],
            "beside": list(self.other_causes),
            "shrink": vars(self.explained_fraction),
            "without": self.without,
        }

    @property
    def other_causes(self) -> tuple[str, ...]:
        """The causes the terms stand beside."""
        learned_ids = {one.term.effect.id for one in self.terms}
        return tuple(i for i in self.fit.ids if i not in learned_ids)


def learn_residual(base: Fit, parents: Sequence[Fit], empirical_terms: Sequence[T]) -> LearnedResidual[T] | None:
    """Return the terms that describe what is left; None where none holds on samples held back.

    Args:
        base: the bare base; the gap is counted from it.
        parents: hypotheses the terms may stand beside, the simplest first.
        empirical_terms: the terms, without their coefficients.
    """
    # A base alone stands for itself, and what belongs to one run says nothing of another.
    parents = [p for k, p in enumerate(parents) if k == 0 or p.ids]
    parents = [p for p in parents if not any(effect.belongs_to_run for effect in p.effects)]
    if all(map(base.problem.model.is_clean, parents)):
        return None
    choices = [_Choice(parent, empirical_terms) for parent in parents]
    parent, terms = _chosen(choices, choices[0].all_cells)
    result, terms = _with_terms(parent, terms, None) if terms else (parent, terms)
    if not terms:
        return None
    scores, per_fold = _score_held_out(base, choices)
    total, low, high = scores.interval("after", "before")
    of_rest = scores.interval("after", "without")
    if min(total, low, of_rest[1]) <= 0.0:
        return None
    ranked = []
    for term in terms:
        at = result.hypothesis.index_of(term.effect.id)
        chosen = np.mean([any((t.place, t.variable) == (term.place, term.variable) for t in fold) for fold in per_fold])
        fitted = replace(term, coefficient=float(result.coordinates[at]))
        ranked.append(LearnedTerm(fitted, _error(result, term.effect.id), float(chosen)))
    without, *_ = scores.interval("without", "before")
    return LearnedResidual(tuple(ranked), ExplainedFraction(total, low, high, total), without, result)


class _Choice(Generic[T]):
    """Which terms stand beside one parent, by products of derivatives, residual and columns of terms."""

    def __init__(self, parent: Fit, terms: Sequence[T]) -> None:
        self.parent = parent
        # Offsets are fitted anew by every prediction; their jumps would drown a small derivative.
        self._bare = fit(parent.problem.bare, parent.hypothesis, parent.coordinates, steps=0)
        # Per run, its samples and, (directions, samples), orthonormal directions of its offsets.
        problem, bare = parent.problem, self._bare
        self._config, self._parts = problem.method.learn, problem.method.explained_fraction.parts
        along = problem.directions(bare.hypothesis, bare.coordinates, bare.predicted, {})
        rows, self._nuisance = rows_of_runs(problem, along), []
        for run in sorted({block.run for block in problem.blocks}):
            at = np.concatenate([np.arange(b.rows.start, b.rows.stop) for b in problem.blocks if b.run == run])
            offsets = (
                np.array([problem.whitened(row)[at] for row in rows[run]]) if run in rows else np.zeros((0, len(at)))
            )
            axes, size, _ = np.linalg.svd(offsets.T, full_matrices=False)
            self._nuisance.append((at, axes[:, size > 1e-6 * max(float(size.max(initial=0.0)), 1e-300)].T))
        self._nuisance_rows = self._cleared(bare.jacobian[np.any(bare.jacobian != 0.0, axis=1)])
        orthogonal, self.candidates, columns = np.linalg.qr(self._nuisance_rows.T)[0], list[T](), list[Array]()
        for term in terms:
            # (samples,) derivative of the prediction with respect to a coefficient that is 0.
            effect, step = term.effect, 0.01 * term.effect.parameters[0].usual
            moved = bare.problem.predict(bare.hypothesis.adding(effect), np.append(bare.coordinates, step))
            column = self._cleared(problem.whitened(np.asarray((moved - bare.predicted) / step))[np.newaxis])
            rest = column[0] - orthogonal @ (orthogonal.T @ column[0])
            if energy(rest) > self._config.distinct * max(energy(column[0]), 1e-12):
                self.candidates.append(term)
                columns.append(column)
        self._rows = np.vstack([self._nuisance_rows, *columns, self._cleared(bare.residual[np.newaxis])])

    def _cleared(self, rows: Array) -> Array:
        """(k, samples) rows without what the offsets of each run take up."""
        out = rows.copy()
        for at, directions in self._nuisance:
            out[:, at] -= (out[:, at] @ directions.T) @ directions
        return out

    @cached_property
    def all_cells(self) -> frozenset[Cell]:
        """Every run and quarter of it in which the sensor is pressed."""
        runs = self.parent.problem.case.runs
        return frozenset((k, q) for k, run in enumerate(runs) if run.kind == "press" for q in range(self._parts))

    @cached_property
    def _products(self) -> dict[Cell, Array]:
        out: dict[Cell, Array] = {}
        for cell, rows_of_cell in _rows_of_cells(self.parent.problem):
            rows = self._rows[:, rows_of_cell]
            out[cell] = out.get(cell, 0.0) + rows @ rows.T
        return out

    def _added(self, cells: Iterable[Cell]) -> Array:
        return np.asarray(np.sum([self._products[cell] for cell in cells], axis=0))

    def noise(self, cells: frozenset[Cell]) -> float:
        """Return χ² of noise alone on the cells, each sample as often as it is held back."""
        problem, runs = self.parent.problem, self.parent.problem.case.runs
        shares = {k: sum(1 for cell in cells if cell[0] == k) / self._parts for k in range(len(runs))}
        return len(splits(cells)) * sum(len(runs[b.run]) * shares[b.run] for b in problem.blocks)

    def forward(self, cells: frozenset[Cell]) -> tuple[list[T], float]:
        """Choose terms on these cells; return them and χ² on parts held back in turn."""
        # Special runs always count for the fit: they calibrate, and are never held back.
        special = [cell for cell in self._products if cell not in self.all_cells]
        parts = splits(cells)
        folds = [
            (self._added((*(cells - part_cells), *special)), self._added(part_cells))
            for part in parts
            for part_cells in part
        ]
        chosen: list[int] = []
        loss, noise = self._held_out_loss(folds, chosen), self.noise(cells)
        config = self._config
        while folds and len(chosen) < config.max_terms:
            losses = {
                k: self._held_out_loss(folds, [*chosen, k]) for k in range(len(self.candidates)) if k not in chosen
            }
            if not losses:
                break
            best = min(losses, key=lambda k: losses[k])
            if loss - losses[best] <= config.min_share * max(loss - noise, 0.0) + config.chance * len(parts):
                break
            chosen, loss = [*chosen, best], losses[best]
        return [self.candidates[k] for k in chosen], loss

    def _held_out_loss(self, folds: Sequence[tuple[Array, Array]], chosen: Sequence[int]) -> float:
        base_count, last = len(self._nuisance_rows), len(self._rows) - 1
        columns = np.array([*range(base_count), *(base_count + k for k in chosen)], dtype=int)
        total = 0.0
        for training, validation in folds:
            normal = training[np.ix_(columns, columns)]
            # A part without contact leaves a direction open; a little damping keeps it where it is.
            damped = normal + np.diag(1e-9 * np.diag(normal) + 1e-12)
            w = np.append(-np.linalg.solve(damped, training[columns, last]), 1.0)
            at = np.append(columns, last)
            total += float(w @ validation[np.ix_(at, at)] @ w)
        return total


def splits(cells: frozenset[Cell]) -> list[list[frozenset[Cell]]]:
    """Return what is held back in turn: each of several runs, then the same quarter of every run."""
    names = [sorted({cell[k] for cell in cells}) for k in (0, 1)]
    return [
        [frozenset(cell for cell in cells if cell[k] == name) for name in names[k]] for k in (0, 1) if len(names[k]) > 1
    ]


def _chosen(choices: Sequence[_Choice[T]], cells: frozenset[Cell]) -> tuple[Fit, list[T]]:
    first, *others = ((choice.parent, *choice.forward(cells)) for choice in choices)
    noise, best = choices[0].noise(cells), first
    for other in others:
        is_far_better = first[2] - other[2] > first[0].problem.method.learn.simpler * max(first[2] - noise, 0.0)
        if is_far_better and other[2] < best[2]:
            best = other
    return best[0], best[1]


def _with_terms(parent: Fit, terms: Sequence[T], weight_of_sample: Array | None) -> tuple[Fit, list[T]]:
    """Fit base, causes and terms together; a term within its own error is left out again."""
    problem, remaining = (
        parent.problem if weight_of_sample is None else parent.problem.seeing(weight_of_sample),
        list(terms),
    )
    while True:
        effects = [term.effect for term in remaining]
        start = np.append(parent.coordinates, start_coordinates(effects, [[0.0]] * len(remaining)))
        fitted = fit(problem, parent.hypothesis.adding(*effects), start, steps=12)
        sizes = [abs(fitted.coordinates[fitted.hypothesis.index_of(e.id)]) / _error(fitted, e.id) for e in effects]
        if not sizes or min(sizes) >= problem.method.learn.errors:
            return fitted, remaining
        remaining.pop(int(np.argmin(sizes)))


def _error(result: Fit, effect_id: str) -> float:
    at = result.hypothesis.index_of(effect_id)
    worse = max(1.0, float(np.sqrt(result.chi2 / max(result.problem.count, 1))))
    return max(worse * float(np.sqrt(max(result.covariance[at, at], 0.0))), 1e-300)


@dataclass(frozen=True, eq=False)
class _Scores:
    """Sums of squares on samples held back, by twin (before, without, after), fold and channel."""

    squares: dict[str, Array]
    """(folds, channels) each."""
    counts: Array
    floors: Array
    method: GapMethod

    def explained_fraction(self, of: str, over: str, excluded_fold: int | None = None) -> float:
        """1 − Σ(after − floor)/Σ(before − floor) over channels, each in units of its noise."""
        is_included = np.arange(len(self.counts)) != (-1 if excluded_fold is None else excluded_fold)

        def gap(model: str) -> float:
            mean = self.squares[model][is_included].sum(axis=0) / np.maximum(self.counts[is_included].sum(axis=0), 1.0)
            return float(np.sum(np.maximum(np.sqrt(mean) - self.floors, 0.0) / self.floors))

        before = gap(over)
        return 1.0 - gap(of) / before if before > 0.0 else 0.0

    def interval(self, of: str, over: str) -> tuple[float, float, float]:
        """The shrink and its jackknife interval over folds (Efron and Tibshirani 1993, ch. 11)."""
        n, value = len(self.counts), self.explained_fraction(of, over)
        each = np.array([self.explained_fraction(of, over, k) for k in range(n)])
        error = float(np.sqrt((n - 1) / n * np.sum((each - each.mean()) ** 2))) if n > 1 else 1.0
        quantile = float(student.ppf(0.5 + 0.5 * self.method.learn.coverage, max(n - 1, 1)))
        margin = max(self.method.explained_fraction.min_margin, quantile * error)
        return value, value - margin, min(1.0, value + margin)


def _score_held_out(base: Fit, choices: Sequence[_Choice[T]]) -> tuple[_Scores, list[list[T]]]:
    cells, problem = choices[0].all_cells, base.problem
    runs = sorted({run for run, _ in cells})
    folds = [frozenset(c for c in cells if c[0] == run) for run in runs]
    if len(runs) == 1:
        folds = [frozenset({cell}) for cell in sorted(cells)]
    channels = problem.scored_channels
    squares = {model: np.zeros((len(folds), len(channels))) for model in ("before", "without", "after")}
    counts, chosen_terms = np.zeros((len(folds), len(channels))), []
    for k, validation in enumerate(folds):
        unseen = np.zeros(len(base.problem.measured), dtype=np.bool_)
        for cell, rows in _rows_of_cells(base.problem):
            unseen[rows] = cell in validation
        training = (~unseen).astype(np.float64)
        parent, terms = _chosen(choices, cells - validation)
        before = fit(problem.seeing(training), base.hypothesis, base.coordinates, steps=6)
        without = before
        if parent.ids:
            without = fit(parent.problem.seeing(training), parent.hypothesis, parent.coordinates, steps=6)
        after, terms = _with_terms(without, terms, training) if terms else (without, terms)
        chosen_terms.append(terms)
        for block in (b for b in problem.blocks if b.channel in channels):
            at, hidden = channels.index(block.channel), unseen[block.rows]
            counts[k, at] += np.count_nonzero(hidden)
            for model, result in (("before", before), ("without", without), ("after", after)):
                squares[model][k, at] += energy((problem.measured - result.predicted)[block.rows][hidden])
    return _Scores(squares, counts, np.array([problem.noise_floor(c) for c in channels]), problem.method), chosen_terms


def _rows_of_cells(problem: Problem) -> Iterator[tuple[Cell, slice]]:
    """Yield the samples of every quarter of every block, with its run and quarter."""
    for block in problem.blocks:
        samples, parts = np.arange(block.rows.start, block.rows.stop), problem.method.explained_fraction.parts
        ends = [part[0] for part in np.array_split(samples, parts)]
        for quarter, (start, stop) in enumerate(pairwise([*ends, block.rows.stop])):
            yield (block.run, quarter), slice(start, stop)
