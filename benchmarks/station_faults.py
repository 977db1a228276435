"""Break the simulated station in every known way and print what became of stage and record.

python benchmarks/station_faults.py [--quick] [--write FILE] [--kept FILE] [--part K N]

With --kept every outcome is written down as it comes and is not run again; delete the file when the code has changed.
"""

import argparse
import json
import math
import tempfile
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np
from common.fault_trial import (
    DISK_MOMENTS,
    FaultOutcome,
    run_with_dead_host,
    run_with_fault,
    run_with_full_disk,
)

from softcal.station.testing.faults import FAULTS

HEADER = (
    "| fault | seen in | after, s | stage stands after, s | largest force, N | recorded | what the operator reads |"
)


def main() -> None:
    """Run all faults and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="every fourth fault")
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the table into this file as well")
    parser.add_argument("--kept", type=Path, metavar="FILE", help="outcomes are kept here, one JSON line each")
    parser.add_argument("--part", type=int, nargs=2, metavar=("K", "N"), help="run the K-th of N parts, print nothing")
    options = parser.parse_args()
    runs: dict[str, Run] = {f.name: partial(run_with_fault, f) for f in FAULTS[:: 4 if options.quick else 1]}
    runs |= {f"disk full: {moment}": partial(run_with_full_disk, moment=moment) for moment in DISK_MOMENTS}
    runs |= {"host dies": run_with_dead_host}
    kept = _read(options.kept)
    if options.part:
        k, n = options.part
        runs = dict(list(runs.items())[k - 1 :: n])
    for name in [name for name in runs if name not in kept]:
        kept[name] = _run(runs[name])
        _keep(options.kept, name, kept[name])
    if options.part:
        return
    outcomes = [kept[name] for name in runs]
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


Run = Callable[[Path], FaultOutcome]


def _read(path: Path | None) -> dict[str, FaultOutcome]:
    lines = path.read_text().splitlines() if path is not None and path.exists() else []
    return {entry["name"]: FaultOutcome(**entry["outcome"]) for entry in map(json.loads, lines)}


def _keep(path: Path | None, name: str, outcome: FaultOutcome) -> None:
    if path is not None:
        with path.open("a") as file:
            file.write(json.dumps({"name": name, "outcome": asdict(replace(outcome, reason=None))}) + "\n")


def _run(run: Run) -> FaultOutcome:
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
