"""Break the simulated station in every known way and print what became of stage and record.

python benchmarks/station_faults.py [--quick] [--kept FILE] [--part K N]
"""

import math
import tempfile
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np
from common.command import Kept, parser_of, part_of
from common.fault_trial import DISK_MOMENTS, FaultOutcome, run_with_dead_host, run_with_fault, run_with_full_disk
from common.tables import print_table

from softcal.station.testing.faults import FAULTS

Run = Callable[[Path], FaultOutcome]


def main() -> None:
    """Run all faults and print the table."""
    options = parser_of(__doc__, "every fourth fault", kept=True).parse_args()
    runs: dict[str, Run] = {f.name: partial(run_with_fault, f) for f in FAULTS[:: 4 if options.quick else 1]}
    runs |= {f"disk full: {moment}": partial(run_with_full_disk, moment=moment) for moment in DISK_MOMENTS}
    runs |= {"host dies": run_with_dead_host}
    kept = Kept(options.kept)
    outcomes = [FaultOutcome(**kept.of(name, partial(_run, runs[name]))) for name in part_of(options, list(runs))]
    stops = np.array([outcome.stopped_s for outcome in outcomes if math.isfinite(outcome.stopped_s)])
    good = sum(outcome.record == "good" for outcome in outcomes)
    hung = sum(outcome.error == "hang" for outcome in outcomes)
    print(
        f"{len(outcomes)} faults of a running station, on its wires, its disk and its host; {good} recorded as good, "
        f"{hung} hung. The stage stood after {np.median(stops):.3f} s (median), {np.max(stops):.3f} s (largest).\n"
    )
    head = "fault | seen in | after, s | stage stands after, s | largest force, N | recorded | what the operator reads"
    print_table(head, map(_row, outcomes))


def _run(run: Run) -> dict[str, object]:
    with tempfile.TemporaryDirectory() as folder:
        outcome = run(Path(folder))
        return asdict(replace(outcome, message=outcome.message.replace(f"{folder}/", ""), reason=None))


def _row(o: FaultOutcome) -> tuple[object, ...]:
    record = "yes" if o.record == "good" else f"no, spool says {o.spool.split(':')[0]}"
    times = (f"{value:.3f}" if math.isfinite(value) else "there before" for value in (o.detected_s, o.stopped_s))
    return o.fault, o.phase, *times, f"{o.largest_force_N:.1f}", record, o.message.replace("|", "/")


if __name__ == "__main__":
    main()
