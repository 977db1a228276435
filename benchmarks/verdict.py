"""How well the label-free verdict knows: forecast against true error over simulated lots with planted bad units.

python benchmarks/verdict.py [--quick] [--seeds FIRST LAST [STEP]]
python benchmarks/verdict.py --fit --seeds 1000 1040     # how the constants of core/unit/forecast.py were found
"""

from collections import Counter
from collections.abc import Iterable

import numpy as np
from common.command import parser_of
from common.own_forecast import COEFFICIENTS
from common.planted import OPPOSITE_DIRECTION
from common.simulated_cases import Case, cases, coverage, roc_auc
from common.tables import print_table
from scipy.optimize import minimize
from scipy.stats import spearmanr

from softcal.core.simulated_lot import GOOD
from softcal.core.unit.correspondence import CorrespondenceTable
from softcal.core.unit.method import DecisionConfig
from softcal.core.unit.verdict import VERDICTS

LARGEST, LARGEST_OWN = np.log(1.5), np.log(2.0)
"""Coefficients stay near what their terms mean: no term is blown up to stand for another."""


def main() -> None:
    parser = parser_of(__doc__, "four lots only")
    parser.add_argument("--seeds", type=int, nargs="+", default=(0, 24), metavar="FIRST LAST [STEP]")
    parser.add_argument("--fit", action="store_true", help="fit the sensitivity coefficients and print them")
    options = parser.parse_args()
    seeds = range(4) if options.quick else range(*options.seeds)
    units = list(cases(seeds))
    if options.fit:
        print_fit(units)
    else:
        print_report(units)


def print_report(units: list[Case]) -> None:
    mapped = [c for c in units if c.calibration is not None]
    good = [c for c in mapped if c.kind == GOOD]
    groups = {"all": units, "stage known": [c for c in units if c.has_stage], "stage unknown": []}
    groups["stage unknown"] = [c for c in units if not c.has_stage]
    groups |= {f"shift: {shift}": [c for c in units if c.shift == shift] for shift in sorted({c.shift for c in units})}
    head = "over | units | after > 1.5 x own | ROC AUC (target 0.95) | Spearman (0.8) | coverage of good, mean"
    print_table(head, (group_row(name, group) for name, group in groups.items() if group))
    harms = ("passed: > 1.5 x own", "passed: > limit", "passed: worse than before")
    kinds = (kind_row(kind, [c for c in units if c.kind == kind]) for kind in dict.fromkeys(c.kind for c in units))
    print_table(("kind", "units", "refused", *VERDICTS, "median after / own", *harms), kinds)
    print_other_scores(units)
    paired = [c for c in good if is_paired(c)]
    stage_matched = [c for c in good if c.has_stage and not is_paired(c)]
    blind = [c for c in good if not (c.has_stage or is_paired(c))]
    for name, group in {
        "all": good,
        "paired in time": paired,
        "stage known": stage_matched,
        "nothing pairs": blind,
    }.items():
        if group:
            print_log_ratio(name, group)


def print_other_scores(units: list[Case]) -> None:
    """Print the area under the curve for what else one could rank by; refused units rank last."""
    labels = [c.is_bad for c in units]
    forecasts = [np.inf if c.calibration is None else float(c.calibration.predicted_rmse or np.inf) for c in units]
    over_source = [f / c.source_rmse for f, c in zip(forecasts, units, strict=True)]
    over_own = [f / c.own for f, c in zip(forecasts, units, strict=True)]
    print(f"ROC AUC of forecast / source's error: {roc_auc(over_source, labels):.3f}", end="; ")
    print(f"of forecast / true error of the own calibration: {roc_auc(over_own, labels):.3f}\n")


def print_log_ratio(name: str, good: list[Case]) -> None:
    """Print quantiles of log(true / forecast) over good units."""
    ratio = np.log([c.after / c.calibration.predicted_rmse for c in good])  # type: ignore[union-attr,operator]
    low, median, high = np.quantile(ratio, (0.025, 0.5, 0.975))
    print(f"log(true / forecast), {name}, {len(good)} good units: median {median:+.2f}, 95 % {low:+.2f} to {high:+.2f}")


def group_row(name: str, group: list[Case]) -> tuple[object, ...]:
    mapped = [c for c in group if c.calibration is not None]
    good = [coverage(c.result, c.test) for c in mapped if c.kind == GOOD and c.result is not None]
    auc = roc_auc([c.score for c in group], [c.is_bad for c in group])
    rank = spearmanr([c.calibration.predicted_rmse for c in mapped], [c.after for c in mapped]).statistic  # type: ignore[union-attr]
    bad = sum(c.is_bad for c in group)
    return name, len(group), bad, f"{auc:.3f}", f"{rank:.3f}", f"{np.mean(good):.1%}"


def kind_row(kind: str, group: list[Case]) -> tuple[object, ...]:
    verdicts = Counter(c.calibration.decision.verdict for c in group if c.calibration is not None)
    refused = sum(c.calibration is None for c in group)
    ratios = [c.after / c.own for c in group if c.calibration is not None]
    passed = [c for c in group if c.calibration is not None and c.calibration.decision.verdict == "pass"]
    harms = (
        sum(c.is_bad for c in passed),
        sum(c.after > DecisionConfig().default_factor * c.source_rmse for c in passed),
        sum(c.after > c.before for c in passed),
    )
    median = f"{np.median(ratios):.2f}" if ratios else "-"
    return kind, len(group), refused, *(verdicts[word] for word in VERDICTS), median, *harms


def print_fit(units: list[Case]) -> None:
    """Print the coefficients that minimise a robust loss of log(true / forecast), by what is known of the loads.

    Reversed units are failed by their wiring; what they misread has nothing to say on others.
    """
    mapped = [c for c in units if c.calibration is not None and c.kind != OPPOSITE_DIRECTION]
    unplaced = [c for c in mapped if not c.has_stage and not is_paired(c)]
    on_stage = [c for c in mapped if c.has_stage and not is_paired(c)]
    kinds = CorrespondenceTable()
    for name, names, group in (
        ("blind", dict(kinds.blind.sensitivity), unplaced),
        ("stage", dict(kinds.stage.sensitivity), on_stage),
    ):
        # Good units stand near the limit, where the forecast decides; planted ones need only be far beyond it.
        weight = np.where([c.kind == GOOD for c in group], 3.0, 1.0)
        after = np.array([c.after for c in group])
        coefficients, residual = fit(budgets(group, "model"), budgets(group, *names), after, weight)
        print(f"{name}.sensitivity = {listed(names, coefficients)}")
        low, high = np.quantile(residual[[c.kind == GOOD for c in group]], (0.025, 0.975))
        print(f"{name}.log_error = ({low:.2f}, {high:.2f})  # {len(group)} units, SD of all {np.std(residual):.2f}")
    paired = [c for c in mapped if is_paired(c)]
    for name, group in (("blind", unplaced), ("stage", on_stage), ("paired", paired)):
        names = COEFFICIENTS[name]
        terms, own_rmse = own_terms(group, *names), np.array([c.own for c in group])
        coefficients, residual = fit(np.zeros((len(group), 1)), terms, own_rmse, np.ones(len(group)), LARGEST_OWN)
        print(f"{name}.own = {listed(names, coefficients)}  # {len(group)} units, SD of all {np.std(residual):.2f}")


def is_paired(case: Case) -> bool:
    """Tell whether the unit was judged by windows under one load with the source."""
    return case.calibration is not None and "paired" in case.calibration.fit.budget


def listed(names: Iterable[str], coefficients: np.ndarray) -> str:
    return "{" + ", ".join(f'"{n}": {c:.2f}' for n, c in zip(names, coefficients, strict=True)) + "}"


def budgets(units: list[Case], *names: str) -> np.ndarray:
    """Return terms of the units' error budgets, (units, names)."""
    return np.array([[c.calibration.fit.budget[n] for n in names] for c in units])  # type: ignore[union-attr]


def own_terms(units: list[Case], *names: str) -> np.ndarray:
    """Return terms of the errors of calibrations of the units' own, (units, names)."""
    return np.array([[c.own_terms[n] for n in names] for c in units])


def fit(
    fixed: np.ndarray, parts: np.ndarray, truth: np.ndarray, weight: np.ndarray, largest: float = LARGEST
) -> tuple[np.ndarray, np.ndarray]:
    """Fit c in truth^2 = fixed^2 + sum (c_i parts_i)^2; return c and log(truth / fitted)."""

    def residual(log_coefficients: np.ndarray) -> np.ndarray:
        squared = fixed[:, 0] ** 2 + (parts**2) @ np.exp(2 * log_coefficients)
        return np.asarray(np.log(truth) - 0.5 * np.log(squared))

    def loss(log_coefficients: np.ndarray) -> float:
        # Huber: a few units are wrong by a factor of ten and must not bend the rest; a prior keeps idle terms small.
        r = np.abs(residual(log_coefficients))
        huber = np.where(r < 0.5, 0.5 * r**2, 0.5 * (r - 0.25))
        return float(weight @ huber + 0.02 * np.sum((log_coefficients - np.log(0.5)) ** 2))

    count = parts.shape[1]
    best = minimize(loss, np.full(count, np.log(0.5)), method="L-BFGS-B", bounds=[(-4, largest)] * count)
    return np.exp(best.x), residual(best.x)


if __name__ == "__main__":
    main()
