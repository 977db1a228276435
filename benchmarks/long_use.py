"""Long use: is following better where a sensor drifts, harmless where it does not, and does every row say which?

    python benchmarks/long_use.py [--streams N] [--beside N] [--seed SEED | --fresh] [--ageing] [--cache FOLDER]
                                  [--nylon SEEDS]

Streams of many kinds, drawn at random by common/simulated_streams.py, and the measured nylon runs (SOFTCAL_DATA). The
exit code is 1 where a goal is missed. The first `--beside` streams are also estimated by the paper's online method, a
quantile re-map, CORAL and, where river is installed, its ADWIN with a refit. A word is due where, over twenty cycles,
the estimates err by more than the alarm's ratio times the error at calibration. It is missed where most of these rows
are `followed` and nothing else. An alarm is false where nothing is due while it stands.
"""

import secrets
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
from common.command import ResultCache, parser_of
from common.followed import Unit, calibrate, follow, part_rmse
from common.map_methods import DATA
from common.simulated_streams import AGEING, KINDS, Stream, draw
from common.tables import print_table
from numpy.typing import NDArray

from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.operation.adapter import Adapter
from softcal.core.operation.method import DriftTracking
from softcal.core.operation.observation import FOLLOWED
from softcal.core.operation.stream_estimator import FLAG_SEPARATOR, STATES
from softcal.core.recording import Array
from softcal.core.unit.estimate import estimate
from softcal.core.windows import TAPS, windows

try:
    from river.drift import ADWIN
except ImportError:
    ADWIN = None

HARM, FALSE_A_DAY, MISSED, COVERED, MAX_US = 1.05, 0.1, 0.05, 0.85, 1000.0
BEST, MEDIAN = 1.1, 0.6
"""On measured runs: largest error over the better of none and `ot`, and largest median error over none."""
BLOCK = 10
"""Cycles over which an error is looked at."""

DAY_S = 86_400.0
ROWS_SHOWN = 15
LEVELS = np.linspace(0.005, 0.995, 100)
RATE_HZ = 10.0
"""Of the nylon runs."""

Remap = Callable[[Array, Array], Callable[[Array], Array]]
"""From output at calibration and output now to a map of windows."""


def quantiles(then: Array, now: Array) -> Callable[[Array], Array]:
    before, after = np.quantile(then, LEVELS), np.quantile(now, LEVELS)
    return lambda rows: np.interp(rows, after, before)


def coral(then: Array, now: Array) -> Callable[[Array], Array]:
    """Sun et al. 2016: whiten the windows now, colour them as at calibration."""
    before, after = windows(then), windows(now)

    def root(values: Array, power: float) -> Array:
        size, axes = np.linalg.eigh(np.cov(values.T) + 1e-6 * np.var(then) * np.eye(TAPS))
        return np.asarray((axes * size**power) @ axes.T)

    turned = root(after, -0.5) @ root(before, 0.5)
    return lambda rows: (rows - after.mean(axis=0)) @ turned + before.mean(axis=0)


def remapped(unit: Unit, then: Array, output: Array, remap: Remap) -> Array:
    """Estimate a stream with a map of its last calibration length, found anew ten times per length."""
    length = len(then)
    history = np.concatenate([then, output])
    estimates = np.full(len(output), np.nan)
    for start in range(0, len(output), length // 10):
        stop = min(len(output), start + length // 10)
        carried = remap(then, history[start : start + length])(
            windows(history[start + length - TAPS + 1 : stop + length])
        )
        estimates[start:stop] = unit.network.evaluate(unit.calibration.unit_map.apply(carried))
    return estimates


def detected(unit: Unit, then: Array, output: Array, cycle: int) -> Array:
    """Estimate a stream with mean and scale fitted anew on the calibration length after each change ADWIN finds."""
    detector, carried, begun = ADWIN(), np.concatenate([then[-TAPS + 1 :], output]), None
    gain, offset, starts = 1.0, 0.0, [(0, 1.0, 0.0)]
    for end in range(cycle, len(output), cycle):
        detector.update(float(output[end - cycle : end].mean()))
        begun = end if detector.drift_detected else begun
        if begun is not None and end - begun >= len(then) // 4:
            segment, begun = output[begun:end], None
            gain = float(then.std() / segment.std())
            offset = float(then.mean() - gain * segment.mean())
            starts.append((end, gain, offset))
    rows = windows(carried)
    for start, gain, offset in starts:
        rows[start:] = gain * windows(carried)[start:] + offset
    return unit.network.evaluate(unit.calibration.unit_map.apply(rows))


@dataclass(frozen=True)
class Outcome:
    """What became of one stream.

    Args:
        kind, unit: of the stream.
        still, followed: error over the stream without and with following.
        ratio, last_ratio: followed over still, over the stream and over its last third.
        is_alarmed: whether an alarm stood anywhere.
        watched_s: its length.
        false_alarms: alarms that stood while nothing was due.
        due, missed: times at which a word was due for two blocks at least; those with `followed` alone on most rows.
        delays: of the others, cycles until the first other flag.
        cautioned: share of the rows at which nothing was due that were `followed` and flagged nevertheless.
        said: the last alarm.
        rows, held: rows with an estimate by state, and those of them whose interval holds the truth.
        still_held: share of the rows without adaptation whose interval does so.
        us: mean time of a sample, in microseconds.
        beside: errors over the stream of what is compared with, over still.
    """

    kind: str
    unit: str
    still: float
    followed: float
    ratio: float
    last_ratio: float
    is_alarmed: bool
    watched_s: float
    false_alarms: int
    due: int
    missed: int
    delays: list[float]
    cautioned: float
    said: str
    rows: dict[str, int]
    held: dict[str, int]
    still_held: float
    us: float
    beside: dict[str, float] = field(default_factory=dict)

    @property
    def is_drifting(self) -> bool:
        return not self.kind.startswith("no drift")


def outcome(stream: Stream, has_other_modes: bool) -> Outcome:
    """Follow one stream and judge every alarm of it."""
    bench, operated = stream.bench, stream.used
    adapter = Adapter(bench.network, bench.calibration, stream.calibrated)
    predicted_rmse = adapter.current.predicted_rmse
    began = time.perf_counter()
    rows = adapter.advance(operated.t_s, operated.output)
    us = (time.perf_counter() - began) / len(operated) * 1e6
    updates = adapter.take_updates()
    state = np.array([flag.rpartition(FLAG_SEPARATOR)[2] for flag in rows.flag])
    alarms = spans([(u.row, u.alarm) for u in updates], len(operated))
    plain = estimate(bench.network, bench.calibration, operated)
    still = plain.estimate
    wrong = np.nan_to_num(rows.estimate - stream.load), np.nan_to_num(still - stream.load)
    whole = [float(np.sqrt(np.mean(e**2))) for e in wrong]
    last = [float(np.sqrt(np.mean(e[-len(e) // 3 :] ** 2))) for e in wrong]
    limit = DriftTracking().uncertainty.alarm_ratio * predicted_rmse
    due = due_spans(wrong[0], BLOCK * stream.cycle, limit)
    long = [(a, b) for a, b in due if b - a >= 2 * BLOCK * stream.cycle]
    is_due = marked(due, len(operated))
    is_flagged = rows.flag != FOLLOWED
    flagged_spans = [span for span in long if is_flagged[slice(*span)].mean() >= 0.5]
    is_inside = (rows.lower <= stream.load) & (stream.load <= rows.upper)
    has_estimate = np.isfinite(rows.estimate)
    return Outcome(
        kind=stream.kind,
        unit=f"{stream.activity}, {stream.curve}{', calibrated on the station' if stream.is_on_station else ''}",
        still=whole[1],
        followed=whole[0],
        ratio=whole[0] / whole[1],
        last_ratio=last[0] / last[1],
        is_alarmed=bool(alarms),
        watched_s=float(np.ptp(operated.t_s)),
        false_alarms=sum(not bool(is_due[a:b].any()) for a, b in alarms),
        due=len(long),
        missed=len(long) - len(flagged_spans),
        delays=[float(np.argmax(is_flagged[slice(*span)])) / stream.cycle for span in flagged_spans],
        cautioned=float(np.mean(~is_due & is_flagged & (state == FOLLOWED))),
        said=next((u.alarm for u in reversed(updates) if u.alarm), ""),
        rows={name: int(np.sum(has_estimate & (state == name))) for name in STATES},
        held={name: int(np.sum(has_estimate & is_inside & (state == name))) for name in STATES},
        still_held=float(np.mean(((plain.lower <= stream.load) & (stream.load <= plain.upper))[TAPS:])),
        us=us,
        beside=beside(stream, whole[1]) if has_other_modes else {},
    )


def beside(stream: Stream, still: float) -> dict[str, float]:
    """Return the error of every other method over that without adaptation."""
    bench, then, output = stream.bench, stream.calibrated.output, stream.used.output
    unit = Unit(bench.source, bench.network, bench.calibration)
    by_mode = {
        mode: follow(unit, mode, stream.used.t_s, output, stream.calibrated)[0] for mode in ("ot", "ot-improved")
    }
    by_mode["quantile re-map"] = remapped(unit, then, output, quantiles)
    by_mode["CORAL"] = remapped(unit, then, output, coral)
    if ADWIN is not None:
        by_mode["ADWIN + refit"] = detected(unit, then, output, stream.cycle)
    return {name: rmse(values, stream.load) / still for name, values in by_mode.items()}


def spans(said: Sequence[tuple[int, str]], rows: int) -> list[tuple[int, int]]:
    """Return from which row to which something was said, of (row, words) with empty words where it ended."""
    spans_found: list[tuple[int, int]] = []
    start = None
    for row, flag in [*said, (rows, "")]:
        if flag and start is None:
            start = row
        elif not flag and start is not None:
            spans_found.append((start, min(row, rows)))
            start = None
    return spans_found


def due_spans(wrong: Array, block: int, limit: float) -> list[tuple[int, int]]:
    """Return the runs of blocks whose root mean square is above a limit."""
    ends = range(block, len(wrong) + 1, block)
    return spans(
        [(end - block, "due" if rmse(wrong[end - block : end], np.zeros(block)) > limit else "") for end in ends],
        len(wrong),
    )


def marked(spans_found: list[tuple[int, int]], rows: int) -> NDArray[np.bool_]:
    """Return (rows,) whether a row is in one of the spans."""
    mask = np.zeros(rows, dtype=bool)
    for a, b in spans_found:
        mask[a:b] = True
    return mask


def outcomes(count: int, with_modes: int, seed: int, cache: Path | None, has_aged: bool) -> Iterator[Outcome]:
    """Judge streams, those of an earlier run from its file."""
    # Numbers of another method are not these.
    kinds, name = (AGEING, "ageing") if has_aged else (KINDS, "long-use")
    results = ResultCache(cache and cache / f"{name}-{seed}-{DriftTracking().id[:12]}.jsonl")
    for number in range(count):
        yield Outcome(
            **results.get(str(number), lambda n=number: asdict(outcome(draw(n, seed, kinds), n < with_modes)))  # type: ignore[misc]
        )


def is_silent(one: Outcome) -> bool:
    return one.ratio > HARM and not one.is_alarmed


def covered(outcomes_of_streams: list[Outcome], state: str) -> float:
    rows = sum(one.rows[state] for one in outcomes_of_streams)
    return sum(one.held[state] for one in outcomes_of_streams) / rows if rows else float("nan")


def false_a_day(outcomes_of_streams: list[Outcome]) -> float:
    return sum(one.false_alarms for one in outcomes_of_streams) / (
        sum(one.watched_s for one in outcomes_of_streams) / DAY_S
    )


def row_of(name: str, outcomes_of_streams: list[Outcome]) -> list[object]:
    ratios, delays = (
        np.array([one.ratio for one in outcomes_of_streams]),
        [delay for one in outcomes_of_streams for delay in one.delays],
    )
    return [
        name,
        len(outcomes_of_streams),
        float(np.median(ratios)),
        float(ratios.max()),
        int(np.sum(ratios > HARM)),
        sum(map(is_silent, outcomes_of_streams)),
        float(np.median([one.last_ratio for one in outcomes_of_streams])),
        sum(one.false_alarms for one in outcomes_of_streams),
        sum(one.due for one in outcomes_of_streams),
        sum(one.missed for one in outcomes_of_streams),
        float(np.median(delays)) if delays else "–",
        100 * float(np.mean([one.cautioned for one in outcomes_of_streams])),
        *(covered(outcomes_of_streams, state) for state in STATES),
        float(np.mean([one.still_held for one in outcomes_of_streams])),
        *(
            100
            * sum(one.rows[state] for one in outcomes_of_streams)
            / sum(sum(one.rows.values()) for one in outcomes_of_streams)
            for state in STATES
        ),
    ]


def print_tables(outcomes_of_streams: list[Outcome]) -> None:
    header = ["kind", "streams", "median ratio", "worst", f"above {HARM:g}", "of these without an alarm"]
    header += ["median, last third", "false alarms", "due", "missed", "median delay [cycles]"]
    header += ["cautioned, not due [%]"]
    header += [f"coverage, {state}" for state in STATES] + ["of none"] + [f"{state} [%]" for state in STATES]
    kinds = {kind: [one for one in outcomes_of_streams if one.kind == kind] for kind in (*KINDS, *AGEING)}
    print_table(
        header, [*(row_of(kind, some) for kind, some in kinds.items() if some), row_of("all", outcomes_of_streams)]
    )
    print()
    header = ["worst streams", "unit", "ratio", "last third", "no adaptation", "followed", "alarm"]
    worst = sorted(outcomes_of_streams, key=lambda one: -one.ratio)[:ROWS_SHOWN]
    print_table(header, [[o.kind, o.unit, o.ratio, o.last_ratio, o.still, o.followed, o.said or "none"] for o in worst])
    print()
    if some := [one for one in outcomes_of_streams if one.beside]:
        names = ["filter", *some[0].beside]
        ratios = [{"filter": one.ratio, **one.beside} for one in some]
        rows = []
        for kind in (*KINDS, *AGEING):
            of_kind = [one for one, outcome in zip(ratios, some, strict=True) if outcome.kind == kind]
            if of_kind:
                rows.append([kind, *(float(np.median([one[name] for one in of_kind])) for name in names)])
        rows.append(["worst of all", *(max(one[name] for one in ratios) for name in names)])
        rows.append(
            [f"share above {HARM:g}", *(float(np.mean([one[name] > HARM for one in ratios])) for name in names)]
        )
        print_table(["median error over none", *names], rows)
        print()


def nylon(seeds: int) -> dict[str, dict[str, Array]]:
    """Print the errors of the nylon runs by quarter; return those of quarters 2, 3, 4 and all over none, by mode."""
    modes = ["none", "improved", "ot 512", "ot-improved 512"]
    ratios: dict[str, dict[str, Array]] = {}
    rows = []
    for path in sorted((DATA / "nylon_drift").glob("*.parquet")):
        t_s, output, reference = pd.read_parquet(path).to_numpy().T
        first, later = slice(0, len(t_s) // 4), slice(len(t_s) // 4, None)
        errors: dict[str, list[list[float]]] = {}
        for seed in range(seeds):
            unit = calibrate(t_s[first], output[first], reference[first], RATE_HZ, NetworkConfig(seed=seed))
            by_mode = {mode: follow(unit, mode, t_s[later], output[later])[0] for mode in modes}
            by_mode["quantile re-map"] = remapped(unit, output[first], output[later], quantiles)
            by_mode["CORAL"] = remapped(unit, output[first], output[later], coral)
            for name, values in by_mode.items():
                errors.setdefault(name, []).append(
                    [*part_rmse(values, reference[later], 3), rmse(values, reference[later])]
                )
        median = {name: np.median(values, axis=0) for name, values in errors.items()}
        rows += [[path.stem, part, *(float(m[k]) for m in median.values())] for k, part in enumerate((2, 3, 4, "all"))]
        ratios[path.stem] = {name: m / median["none"] for name, m in median.items()}
    if rows:
        print_table(["nylon run", "quarter", *ratios[str(rows[0][0])]], rows)
        print()
    return ratios


def times_us(samples: int = 4000) -> Array:
    """Return (samples,) times of single samples on the wall clock, in microseconds."""
    stream = draw(0, 0)
    adapter = Adapter(stream.bench.network, stream.bench.calibration, stream.calibrated)
    durations = []
    for t_s, output in zip(stream.used.t_s[:samples].tolist(), stream.used.output[:samples].tolist(), strict=True):
        began = time.perf_counter()
        adapter.step(t_s, output)
        durations.append((time.perf_counter() - began) * 1e6)
    return np.array(durations)


def nylon_goals(runs: dict[str, dict[str, Array]]) -> Iterator[tuple[str, float, float]]:
    """Yield each goal of the measured runs with what was found and the largest number that meets it."""
    for run, ratios in runs.items():
        best = min(1.0, float(ratios["ot 512"][3]))
        yield f"{run}: error over the better of none and ot", float(ratios["improved"][3]) / best, BEST
        yield f"{run}: worst quarter over none", float(ratios["improved"][:3].max()), HARM
    if runs:
        yield "nylon, median error over none", float(np.median([r["improved"][3] for r in runs.values()])), MEDIAN


def stream_goals(outcomes_of_streams: list[Outcome]) -> Iterator[tuple[str, float, float]]:
    """Yield each goal of the drawn streams with what was found and the largest number that meets it."""
    if not outcomes_of_streams:
        return
    unmoved = [one.ratio for one in outcomes_of_streams if not one.is_drifting]
    due = sum(one.due for one in outcomes_of_streams)
    if unmoved:
        yield "worst error over none, without drift", max(unmoved), HARM
        yield (
            "false alarms a day, without drift",
            false_a_day([one for one in outcomes_of_streams if not one.is_drifting]),
            FALSE_A_DAY,
        )
    yield f"streams above {HARM:g} without an alarm", sum(map(is_silent, outcomes_of_streams)), 0
    yield "false alarms a day, all", false_a_day(outcomes_of_streams), FALSE_A_DAY
    yield "due times missed", sum(one.missed for one in outcomes_of_streams) / max(1, due), MISSED
    for state in STATES:
        yield f"not covered, {state}", 1 - covered(outcomes_of_streams, state), 1 - COVERED
    single = times_us()
    yield "time of a sample, median [µs]", float(np.median(single)), MAX_US
    yield "time of a sample, 99th percentile [µs]", float(np.quantile(single, 0.99)), MAX_US


if __name__ == "__main__":
    parser = parser_of(__doc__)
    parser.add_argument("--streams", type=int, default=528, metavar="N")
    parser.add_argument("--beside", type=int, default=44, metavar="N")
    parser.add_argument("--seed", type=int, default=400)
    parser.add_argument("--fresh", action="store_true", help="a seed nobody has seen")
    parser.add_argument("--ageing", action="store_true", help="streams of sensors that age from the calibration on")
    parser.add_argument("--cache", type=Path, help="go on with a run that was cut off")
    parser.add_argument(
        "--nylon", type=int, default=1, metavar="SEEDS", help="networks of a nylon run; 0 leaves them out"
    )
    options = parser.parse_args()
    seed = secrets.randbelow(10**9) if options.fresh else options.seed
    print(f"seed {seed}, {options.streams} streams\n")
    results = list(outcomes(options.streams, options.beside, seed, options.cache, options.ageing))
    if results:
        print_tables(results)
    reached = [*stream_goals(results), *nylon_goals(nylon(options.nylon) if options.nylon else {})]
    print_table(
        ["goal", "found", "at most", "met"], [[n, float(v), float(m), "yes" if v <= m else "no"] for n, v, m in reached]
    )
    sys.exit(any(value > maximum or value != value for _, value, maximum in reached))
