"""Share of samples whose force lies in the 90 % interval, on good units of simulated lots (target 87 to 93 %).

python benchmarks/interval_coverage.py [--quick] [--seeds FIRST LAST]
python benchmarks/interval_coverage.py --fit --seeds 1000 1016   # coverage by share of the variance
"""

from dataclasses import replace

import numpy as np
from common.command import parser_of
from common.simulated_cases import Case, cases, coverage
from common.tables import print_table

from softcal.core.simulated_lot import GOOD
from softcal.core.unit.correspondence import CorrespondenceTable
from softcal.core.unit.estimate import estimate
from softcal.core.unit.uncertainty import DIRECTIONS

SHARES = (0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 1.1, 1.25)


def main() -> None:
    parser = parser_of(__doc__, "four lots only")
    parser.add_argument("--seeds", type=int, nargs=2, default=(0, 24), metavar=("FIRST", "LAST"))
    parser.add_argument("--fit", action="store_true", help="print coverage by share instead")
    options = parser.parse_args()
    first, last = (0, 4) if options.quick else options.seeds
    good = [c for c in cases(range(first, last), faults=(), has_own=False) if c.kind == GOOD and c.result is not None]
    groups: dict[str, list[Case]] = {"all": good, "stage known": [], "stage unknown": []}
    for case in good:
        groups["stage known" if case.has_stage else "stage unknown"].append(case)
    for name, group in groups.items():
        if group:
            print_shares(name, group) if options.fit else print_group(name, group)


def print_group(name: str, group: list[Case]) -> None:
    per_unit = [coverage(c.result, c.test) for c in group]
    low, middle, high = np.quantile(per_unit, (0.1, 0.5, 0.9))
    trusted = np.mean([coverage(c.result, c.test, trusted_only=True) for c in group])
    print(f"**{name}**: {len(group)} units, mean {np.mean(per_unit):.1%}, unflagged rows {trusted:.1%}, ", end="")
    print(f"units' 10/50/90 %: {low:.0%} / {middle:.0%} / {high:.0%}\n")
    thirds = range(3)
    rows = (
        (direction, *(f"{np.mean(np.concatenate([hits(c, d, third) for c in group])):.1%}" for third in thirds))
        for d, direction in enumerate(DIRECTIONS)
    )
    print_table("direction | lower third | middle third | upper third", rows)


def hits(case: Case, direction: int, third: int) -> np.ndarray:
    """Return which samples of one direction and third of the load range lie in their interval."""
    force, result = case.test.reference, case.result
    slope = np.gradient(force)
    moving = np.quantile(np.abs(slope), 0.9) * 0.15
    sign = 1 + (slope > moving).astype(int) - (slope < -moving)
    level = np.clip((force - force.min()) / np.ptp(force) * 3, 0, 2).astype(int)
    rows = np.isfinite(result.estimate) & (sign == direction) & (level == third)
    return np.asarray((result.lower <= force) & (force <= result.upper))[rows]


def print_shares(name: str, group: list[Case]) -> None:
    for share in SHARES:
        print(f"{name}, share {share:g}: {np.mean([with_share(c, share) for c in group]):.1%}")


def with_share(case: Case, share: float) -> float:
    """Return the coverage had this share of the map's variance been used."""
    kinds = CorrespondenceTable()
    interval_share = (kinds.stage if case.has_stage else kinds.blind).interval_share
    added = case.calibration.interval.half_width**2 - case.source_half_width**2
    half_width = np.sqrt(case.source_half_width**2 + added * share / interval_share)
    interval = replace(case.calibration.interval, half_width=half_width)
    fit = replace(case.calibration.fit, fitted=replace(case.calibration.fitted, interval=interval))
    return coverage(estimate(case.network, replace(case.calibration, fit=fit), case.test.unlabelled), case.test)


if __name__ == "__main__":
    main()
