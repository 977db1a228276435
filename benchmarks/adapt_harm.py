"""Does following do harm, and does the alarm say so? Streams of eighteen kinds, drawn at random.

    python benchmarks/adapt_harm.py [--streams FIRST LAST] [--seed SEED] [--cache FOLDER]

Seed 0 chose constants of the method and is not reported. With --cache a run that was cut off goes on where it ended.
The estimates are due for a recalibration where, over ten cycles, they err by more than the alarm's ratio times the
error at calibration.
"""

import argparse
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from adapt_common import print_markdown
from numpy.typing import NDArray
from simulated_streams import KINDS, Stream, draw

from softcal.core.metrics import rmse
from softcal.core.recording import Array
from softcal.core.unit.estimate import estimate
from softcal.core.use.adapter import AdaptConfig, Adapter
from softcal.core.use.method import UseMethod
from softcal.core.use.observation import PRELOADED

HARM = 1.05
BLOCK = 10
"""Cycles over which an error is looked at."""

DAY_S = 86_400.0
SHOWN = 12


@dataclass(frozen=True)
class Outcome:
    """What became of one stream.

    Args:
        kind, unit: of the stream.
        still, followed: error over the stream without and with following.
        ratio, last_ratio: followed over still, over the stream and over its last third.
        is_alarmed: whether an alarm stood anywhere.
        is_said: whether the record said that a preload that changes cannot be told from drift.
        unwatched: share of the stream of which the record says that it is not watched yet.
        watched_s: its length.
        false_alarms: alarms that stood while nothing was due.
        due: times at which a recalibration was due for two blocks at least.
        told, flagged, missed: those without an alarm: the stream was said to be unwatched; its wrong rows were flagged,
            and those without a flag err by less; the rest.
        delays: of those with an alarm, cycles until it stood.
        standing: share of the time in which nothing was due that was under an alarm.
        said: the last alarm.
    """

    kind: str
    unit: str
    still: float
    followed: float
    ratio: float
    last_ratio: float
    is_alarmed: bool
    is_said: bool
    unwatched: float
    watched_s: float
    false_alarms: int
    due: int
    told: int
    flagged: int
    missed: int
    delays: list[float]
    standing: float
    said: str


def outcome(stream: Stream) -> Outcome:
    """Follow one stream and judge every alarm of it."""
    bench, used = stream.bench, stream.used
    adapter = Adapter(bench.network, bench.calibration, stream.calibrated)
    promised = adapter.current.predicted_rmse
    rows = adapter.advance(used.t_s, used.output)
    found = rows.estimate
    updates = adapter.take_updates()
    alarms = spans([(u.row, u.alarm) for u in updates], len(used))
    unwatched = spans([(u.row, "unwatched" if u.verdict == "unwatched" else "") for u in updates], len(used))
    still = estimate(bench.network, bench.calibration, used).estimate
    wrong = np.nan_to_num(found - stream.load), np.nan_to_num(still - stream.load)
    whole = [float(np.sqrt(np.mean(e**2))) for e in wrong]
    last = [float(np.sqrt(np.mean(e[-len(e) // 3 :] ** 2))) for e in wrong]
    limit = AdaptConfig().method.doubt.alarm_ratio * promised
    due = due_spans(wrong[0], BLOCK * stream.cycle, limit)
    long = [(a, b) for a, b in due if b - a >= 2 * BLOCK * stream.cycle]
    is_due, is_alarm, is_unwatched = (marked(s, len(used)) for s in (due, alarms, unwatched))
    begins = [min((max(a, start) for start, end in alarms if start < b and end > a), default=None) for a, b in long]
    silent = [span for span, begin in zip(long, begins, strict=True) if begin is None]
    told = [is_unwatched[a:b].mean() > 0.5 for a, b in silent]
    # Wrong where the record says that the row is not to be trusted, right elsewhere.
    plain = np.where(rows.flag == "", wrong[0], np.nan)
    flagged = [not float(np.nan_to_num(np.nanmean(plain[a:b] ** 2))) > limit**2 for a, b in silent]
    unit = f"{stream.activity}, {stream.curve}{', calibrated on the station' if stream.is_on_station else ''}"
    return Outcome(
        kind=stream.kind,
        unit=unit,
        still=whole[1],
        followed=whole[0],
        ratio=whole[0] / whole[1],
        last_ratio=last[0] / last[1],
        is_alarmed=bool(alarms),
        is_said=any(u.reason == PRELOADED for u in updates),
        unwatched=float(is_unwatched.mean()),
        watched_s=float(np.ptp(used.t_s)),
        false_alarms=sum(not is_due[a:b].any() for a, b in alarms),
        due=len(long),
        told=int(sum(told)),
        flagged=sum(f and not t for f, t in zip(flagged, told, strict=True)),
        missed=sum(not f and not t for f, t in zip(flagged, told, strict=True)),
        delays=[(begin - a) / stream.cycle for (a, _), begin in zip(long, begins, strict=True) if begin is not None],
        standing=float(is_alarm[~is_due].mean()) if not is_due.all() else 0.0,
        said=next((u.alarm for u in reversed(updates) if u.alarm), ""),
    )


def spans(said: Sequence[tuple[int, str]], rows: int) -> list[tuple[int, int]]:
    """Return from which row to which something was said, of (row, words) with empty words where it ended."""
    found: list[tuple[int, int]] = []
    start = None
    for row, words in [*said, (rows, "")]:
        if words and start is None:
            start = row
        elif not words and start is not None:
            found.append((start, min(row, rows)))
            start = None
    return found


def due_spans(wrong: Array, block: int, limit: float) -> list[tuple[int, int]]:
    """Return the runs of blocks whose root mean square is above a limit."""
    ends = range(block, len(wrong) + 1, block)
    return spans(
        [(end - block, "due" if rmse(wrong[end - block : end], np.zeros(block)) > limit else "") for end in ends],
        len(wrong),
    )


def marked(found: list[tuple[int, int]], rows: int) -> NDArray[np.bool_]:
    """Return (rows,) whether a row is in one of the spans."""
    mask = np.zeros(rows, dtype=bool)
    for a, b in found:
        mask[a:b] = True
    return mask


def outcomes(numbers: range, seed: int, cache: Path | None) -> Iterator[Outcome]:
    """Judge streams, those of an earlier run from its file."""
    path = None
    if cache is not None:
        cache.mkdir(parents=True, exist_ok=True)
        # Numbers of another method are not these.
        path = cache / f"harm-{seed}-{UseMethod().id[:12]}.jsonl"
    known: dict[int, Outcome] = {}
    if path is not None and path.exists():
        known = {row.pop("number"): Outcome(**row) for row in map(json.loads, path.read_text().splitlines())}
    for number in numbers:
        if number not in known:
            known[number] = outcome(draw(number, seed))
            if path is not None:
                with path.open("a") as file:
                    file.write(json.dumps({"number": number, **asdict(known[number])}) + "\n")
        yield known[number]


def is_silent(one: Outcome) -> bool:
    return one.ratio > HARM and not one.is_alarmed and not one.is_said


def harm_row(name: str, found: list[Outcome]) -> list[object]:
    ratios = np.array([one.ratio for one in found])
    return [
        name,
        len(found),
        float(np.median(ratios)),
        float(ratios.max()),
        int(np.sum(ratios > HARM)),
        sum(one.ratio > HARM and not one.is_alarmed and one.is_said for one in found),
        sum(map(is_silent, found)),
        float(np.median([one.last_ratio for one in found])),
    ]


def alarm_row(name: str, found: list[Outcome]) -> list[object]:
    days = sum(one.watched_s for one in found) / DAY_S
    delays = [delay for one in found for delay in one.delays]
    false = sum(one.false_alarms for one in found)
    return [
        name,
        days,
        false,
        false / days,
        100 * float(np.mean([one.standing for one in found])),
        sum(one.due for one in found),
        sum(one.told for one in found),
        sum(one.flagged for one in found),
        sum(one.missed for one in found),
        *(float(np.quantile(delays, q)) if delays else "–" for q in (0.5, 0.9)),
        100 * float(np.mean([one.unwatched for one in found])),
    ]


def print_tables(found: list[Outcome]) -> None:
    header = ["kind", "streams", "median ratio", "worst", f"above {HARM:g}", "of these said, not alarmed", "not said"]
    alarms = [
        "kind",
        "days",
        "false alarms",
        "a day",
        "standing where nothing is due [%]",
        "due",
        "said to be unwatched",
        "flagged row by row",
        "missed",
    ]
    alarms += ["delay [cycles]: median", "90 %", "not watched yet [%]"]
    tables: list[tuple[list[str], Callable[[str, list[Outcome]], list[object]]]] = [
        ([*header, "median, last third"], harm_row),
        (alarms, alarm_row),
    ]
    for titles, row in tables:
        kinds = {kind: [one for one in found if one.kind == kind] for kind in KINDS}
        print_markdown(titles, [*(row(kind, some) for kind, some in kinds.items() if some), row("all", found)])
        print()
    worst = sorted(found, key=lambda one: -one.ratio)[:SHOWN]
    header = ["worst streams", "unit", "ratio", "last third", "no adaptation", "followed", "alarm"]
    print_markdown(
        header, [[o.kind, o.unit, o.ratio, o.last_ratio, o.still, o.followed, o.said or "none"] for o in worst]
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--streams", type=int, nargs=2, default=(0, 540), metavar=("FIRST", "LAST"))
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--cache", type=Path)
    options = parser.parse_args()
    print_tables(list(outcomes(range(*options.streams), options.seed, options.cache)))
