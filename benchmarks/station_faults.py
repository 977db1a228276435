"""Break the simulated station in every known way and print what became of stage and record.

python benchmarks/station_faults.py [--quick] [--write FILE]
"""

import argparse
import math
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from softcal.station.simulated.faults import FAULTS
from softcal.station.simulated.trial import (
    DISK_MOMENTS,
    FaultOutcome,
    run_with_dead_host,
    run_with_fault,
    run_with_full_disk,
)

HEADER = (
    "| fault | seen in | after, s | stage stands after, s | largest force, N | recorded | what the operator reads |"
)


def main() -> None:
    """Run all faults and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="every fourth fault")
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the table into this file as well")
    options = parser.parse_args()
    outcomes = [_run(partial(run_with_fault, fault)) for fault in FAULTS[:: 4 if options.quick else 1]]
    outcomes += [_run(partial(run_with_full_disk, moment=moment)) for moment in DISK_MOMENTS]
    outcomes += [_run(run_with_dead_host)]
    stops = np.array([outcome.stopped_s for outcome in outcomes if math.isfinite(outcome.stopped_s)])
    good, hung = (sum(map(is_so, outcomes)) for is_so in (_is_good, _hangs))
    lines = [
        f"{len(outcomes)} faults of a running station, on its wires, its disk and its host; {good} recorded as good, "
        f"{hung} hung. The stage stood after {np.median(stops):.3f} s (median), {np.max(stops):.3f} s (largest).",
        "",
        HEADER,
        "|" + "---|" * 7,
        *[_row(outcome) for outcome in outcomes],
    ]
    print("\n".join(lines))
    if options.write:
        options.write.write_text("\n".join(lines) + "\n")


def _run(run: Callable[[Path], FaultOutcome]) -> FaultOutcome:
    with tempfile.TemporaryDirectory() as folder:
        outcome = run(Path(folder))
        return replace(outcome, message=outcome.message.replace(f"{folder}/", ""))


def _is_good(outcome: FaultOutcome) -> bool:
    return outcome.record == "good"


def _hangs(outcome: FaultOutcome) -> bool:
    return outcome.error == "hang"


def _row(o: FaultOutcome) -> str:
    message = o.message.replace("|", "/")
    record = "yes" if o.record == "good" else f"no, spool says {o.spool.split(':')[0]}"
    times = (f"{value:.3f}" if math.isfinite(value) else "there before" for value in (o.detected_s, o.stopped_s))
    return f"| {o.fault} | {o.phase} | {' | '.join(times)} | {o.largest_force_N:.1f} | {record} | {message} |"


if __name__ == "__main__":
    main()
