"""How well the label-free verdict knows: forecast against true error over simulated lots with planted bad units.

python benchmarks/verdict.py [--quick] [--seeds FIRST LAST]
python benchmarks/verdict.py --fit --seeds 1000 1048     # how the constants of core/forecast.py were found
"""

import argparse
from collections import Counter

import numpy as np
from scipy.optimize import minimize
from scipy.stats import spearmanr
from simulated_cases import Case, cases, coverage, roc_auc

from softcal.core.forecast import SENSITIVITY, SENSITIVITY_ON_STAGE
from softcal.core.simulated_lot import GOOD, OPPOSITE_DIRECTION
from softcal.core.verdict import DEFAULT_FACTOR, VERDICTS

LARGEST = np.log(1.5)
"""Coefficients stay near what their terms mean: no term is blown up to stand for another."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="four lots only")
    parser.add_argument("--seeds", type=int, nargs=2, default=(0, 24), metavar=("FIRST", "LAST"))
    parser.add_argument("--fit", action="store_true", help="fit the sensitivity coefficients and print them")
    options = parser.parse_args()
    first, last = (0, 4) if options.quick else options.seeds
    units = list(cases(range(first, last), has_own=not options.fit))
    if options.fit:
        print_fit(units)
    else:
        print_report(units)


def print_report(units: list[Case]) -> None:
    mapped = [c for c in units if c.calibration is not None]
    good = [c for c in mapped if c.kind == GOOD]
    print("| over | units | after > 1.5 x own | ROC AUC (target 0.95) | Spearman (0.8) | coverage of good, mean |")
    print("|---|---|---|---|---|---|")
    groups = {"all": units, "stage known": [c for c in units if c.has_stage], "stage unknown": []}
    groups["stage unknown"] = [c for c in units if not c.has_stage]
    groups |= {f"shift: {shift}": [c for c in units if c.shift == shift] for shift in sorted({c.shift for c in units})}
    for name, group in groups.items():
        if group:
            print(group_row(name, group))
    harms = "passed: > 1.5 x own | passed: > limit | passed: worse than before"
    print("\n| kind | units | refused | " + " | ".join(VERDICTS) + f" | median after / own | {harms} |")
    print("|---" * (7 + len(VERDICTS)) + "|")
    for kind in dict.fromkeys(c.kind for c in units):
        print(kind_row(kind, [c for c in units if c.kind == kind]))
    ratio = np.log([c.after / c.calibration.predicted_rmse for c in good])  # type: ignore[union-attr,operator]
    print(f"\nlog(true / forecast) of good units: median {np.median(ratio):+.2f}, SD {np.std(ratio):.2f}")


def group_row(name: str, group: list[Case]) -> str:
    mapped = [c for c in group if c.calibration is not None]
    good = [coverage(c.result, c.test) for c in mapped if c.kind == GOOD and c.result is not None]
    auc = roc_auc([c.score for c in group], [c.is_bad for c in group])
    rank = spearmanr([c.calibration.predicted_rmse for c in mapped], [c.after for c in mapped]).statistic  # type: ignore[union-attr]
    bad = sum(c.is_bad for c in group)
    return f"| {name} | {len(group)} | {bad} | {auc:.3f} | {rank:.3f} | {np.mean(good):.1%} |"


def kind_row(kind: str, group: list[Case]) -> str:
    words = Counter(c.calibration.verdict.word for c in group if c.calibration is not None)
    refused = sum(c.calibration is None for c in group)
    ratios = [c.after / c.own for c in group if c.calibration is not None]
    passed = [c for c in group if c.calibration is not None and c.calibration.verdict.word == "pass"]
    harms = (
        sum(c.is_bad for c in passed),
        sum(c.after > DEFAULT_FACTOR * c.source_rmse for c in passed),
        sum(c.after > c.before for c in passed),
    )
    median = f"{np.median(ratios):.2f}" if ratios else "-"
    counts = " | ".join(str(words[word]) for word in VERDICTS)
    return f"| {kind} | {len(group)} | {refused} | {counts} | {median} | {' | '.join(map(str, harms))} |"


def print_fit(units: list[Case]) -> None:
    """Print the coefficients that minimise a robust loss of log(true / forecast), with and without stage position.

    Reversed units are failed by their wiring; what they misread has nothing to say on others.
    """
    mapped = [
        c
        for c in units
        if c.calibration is not None and "u_paired" not in c.calibration.evidence and c.kind != OPPOSITE_DIRECTION
    ]
    for suffix, names, has_stage in (("", SENSITIVITY, False), ("_ON_STAGE", SENSITIVITY_ON_STAGE, True)):
        group = [c for c in mapped if c.has_stage == has_stage]
        coefficients, residual = fit(group, list(names))
        listed = ", ".join(f'"{name}": {value:.2f}' for name, value in coefficients.items())
        print(f"SENSITIVITY{suffix} = {{{listed}}}")
        low, high = np.quantile(residual[[c.kind == GOOD for c in group]], (0.025, 0.975))
        print(f"LOG_ERROR{suffix} = ({low:.2f}, {high:.2f})  # {len(group)} units, SD of all {np.std(residual):.2f}")


def fit(units: list[Case], names: list[str]) -> tuple[dict[str, float], np.ndarray]:
    parts = np.array([[float(str(c.calibration.evidence[f"u_{n}"])) for n in ["model", *names]] for c in units])  # type: ignore[union-attr]
    truth = np.log([c.after for c in units])
    # Good units stand near the limit, where the forecast decides; planted ones need only be far beyond it.
    weight = np.where([c.kind == GOOD for c in units], 3.0, 1.0)

    def residual(log_coefficients: np.ndarray) -> np.ndarray:
        squared = parts[:, 0] ** 2 + (parts[:, 1:] ** 2) @ np.exp(2 * log_coefficients)
        return np.asarray(truth - 0.5 * np.log(squared))

    def loss(log_coefficients: np.ndarray) -> float:
        # Huber: a few units are wrong by a factor of ten and must not bend the rest; a prior keeps idle terms small.
        r = np.abs(residual(log_coefficients))
        huber = np.where(r < 0.5, 0.5 * r**2, 0.5 * (r - 0.25))
        return float(weight @ huber + 0.02 * np.sum((log_coefficients - np.log(0.5)) ** 2))

    best = minimize(loss, np.full(len(names), np.log(0.5)), method="L-BFGS-B", bounds=[(-4, LARGEST)] * len(names))
    return dict(zip(names, np.exp(best.x), strict=True)), residual(best.x)


if __name__ == "__main__":
    main()
