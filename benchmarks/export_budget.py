"""The uncertainty budget of docs/certificates.md against Monte Carlo (GUM Supplement 1, JCGM 101:2008).

    python benchmarks/export_budget.py

The draws go through the measurement equation and use nothing of core/unit/budget.py.
"""

from dataclasses import replace
from datetime import date

import numpy as np

from softcal.core.unit.budget import Reference, forecast_budget
from softcal.core.unit.knowledge import KnowledgeTable, LoadKnowledge

DRAWS = 2_000_000
CELL = Reference(
    "LC-0417",
    "D-K-15019-2026-0815",
    "",
    date(2026, 2, 3),
    date(2028, 2, 2),
    date(2026, 3, 4),
    uncertainty=0.012,
    capacity=10.0,
    drift=0.010,
    temperature_per_K=0.0005,
    temperature_K=3.0,
    contact=0.006,
    repeatability=0.004,
)
TERMS = {"model": 0.060, "resolution": 0.020}
CASES = (
    ("the example, 2 N", CELL, 2.0, 0.090),
    ("7.5 N, f and map small", CELL, 7.5, 0.0601),
    ("drift not stated", replace(CELL, drift=None), 2.0, 0.090),
    ("drift dominates", replace(CELL, drift=0.2), 2.0, 0.0601),
    ("warm hall, 1 %/K at 7.5 N", replace(CELL, temperature_per_K=0.01), 7.5, 0.090),
    ("U = 5 N", replace(CELL, uncertainty=5.0), 7.5, 0.090),
)


def errors(reference: Reference, load: float, rmse: float, rng: np.random.Generator) -> np.ndarray:
    """Errors of the estimate in N: reading = (load + calibration + drift)(1 + c dT) + contact + repeatability."""
    expanded = reference.uncertainty or 0.0
    drift = expanded if reference.drift is None else reference.drift
    kept = load + rng.normal(0, expanded / reference.coverage_factor, DRAWS) + rng.uniform(-drift, drift, DRAWS)
    kelvin = rng.uniform(-1, 1, DRAWS) * (reference.temperature_K or 0.0)
    reading = kept * (1 + (reference.temperature_per_K or 0.0) * kelvin) + rng.normal(0, reference.contact or 0, DRAWS)
    return np.asarray(reading + rng.normal(0, np.hypot(reference.repeatability or 0, rmse), DRAWS) - load)


def main() -> None:
    """Print the table."""
    rng = np.random.default_rng(20201900178)
    knowledge = LoadKnowledge("stage", KnowledgeTable().stage)
    print("| case | u, budget [mN] | u, Monte Carlo [mN] | difference | U = 2 u [mN] | 95.45 % interval / 2 [mN] |")
    print("|---|---|---|---|---|---|")
    for name, reference, load, rmse in CASES:
        budget = forecast_budget(TERMS, knowledge, rmse, reference, load)
        drawn = errors(reference, load, rmse, rng)
        half = float(np.diff(np.quantile(drawn, (0.02275, 0.97725)))[0]) / 2
        off = budget.standard / drawn.std() - 1
        print(
            f"| {name} | {1e3 * budget.standard:.2f} | {1e3 * drawn.std():.2f} | {off:+.2%} | "
            f"{1e3 * budget.expanded:.1f} | {1e3 * half:.1f} |"
        )


if __name__ == "__main__":
    main()
