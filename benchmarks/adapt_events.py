"""Abrupt events on a simulated gait: samples until the error is back, or what was held and said.

python benchmarks/adapt_events.py [--quick]
"""

import argparse
from collections.abc import Callable, Iterator

import numpy as np
from adapt_common import Unit, calibrate, print_markdown
from numpy.typing import NDArray
from simulated_gait import RATE_HZ, Sensor, Walk, walk

from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.recording import Array
from softcal.core.use.batches import Batches

BEFORE_S, AFTER_S, FAULT_S = 60.0, 240.0, 20.0
BACK = 3.0
"""The error is back when the RMSE of two seconds stays below this many times that before the event."""

Stream = tuple[Array, Array, Array]
Event = Callable[[Stream, np.random.Generator], Stream]


def after(t_s: Array) -> NDArray[np.bool_]:
    return t_s >= BEFORE_S


def during(t_s: Array) -> NDArray[np.bool_]:
    return (t_s >= BEFORE_S) & (t_s < BEFORE_S + FAULT_S)


def reseated(stream: Stream, rng: np.random.Generator) -> Stream:
    t_s, output_V, force_N = stream
    return t_s, np.where(after(t_s), 0.94 * output_V + 0.12, output_V), force_N


def redonned(stream: Stream, rng: np.random.Generator) -> Stream:
    t_s, output_V, force_N = reseated(stream, rng)
    return np.where(after(t_s), t_s + 600.0, t_s), output_V, force_N


def cable_fault(stream: Stream, rng: np.random.Generator) -> Stream:
    t_s, output_V, force_N = stream
    return t_s, np.where(during(t_s), rng.choice([0.0, 5.0], len(t_s)), output_V), force_N


def stops(stream: Stream, rng: np.random.Generator) -> Stream:
    t_s, output_V, force_N = stream
    return t_s, np.where(after(t_s), 1.234, output_V), force_N


def missing_values(stream: Stream, rng: np.random.Generator) -> Stream:
    t_s, output_V, force_N = stream
    return t_s, np.where(during(t_s), np.nan, output_V), force_N


def dropped(stream: Stream, rng: np.random.Generator) -> Stream:
    kept = rng.random(len(stream[0])) > 0.01
    return stream[0][kept], stream[1][kept], stream[2][kept]


def duplicated(stream: Stream, rng: np.random.Generator) -> Stream:
    times = 1 + (rng.random(len(stream[0])) < 0.01)
    return np.repeat(stream[0], times), np.repeat(stream[1], times), np.repeat(stream[2], times)


def other_rate(stream: Stream, rng: np.random.Generator) -> Stream:
    t_s, output_V, force_N = stream
    steps = np.where(during(t_s), 0.6, 1.0) / RATE_HZ
    return np.cumsum(steps), output_V, force_N


def heavier(stream: Stream, rng: np.random.Generator) -> Stream:
    return other_walk(Walk(body_N=2.8), rng)


def runs(stream: Stream, rng: np.random.Generator) -> Stream:
    return other_walk(Walk(stride_s=0.7, body_N=2.4, variation=0.06), rng)


def other_walk(style: Walk, rng: np.random.Generator) -> Stream:
    force_N = np.concatenate([walk(BEFORE_S, rng), walk(AFTER_S, rng, style)])
    return (*Sensor(rng).read(force_N), force_N)


EVENTS: dict[str, Event] = {
    "re-seated while walking": reseated,
    "taken off, re-donned 10 min later": redonned,
    "cable fault for 20 s": cable_fault,
    "no value for 20 s": missing_values,
    "sensor stops": stops,
    "1 % of samples dropped": dropped,
    "1 % of samples repeated": duplicated,
    "rate 1.67 times as high for 20 s": other_rate,
    "the person carries 40 % more": heavier,
    "the person runs": runs,
}


def samples_until_back(t_s: Array, error: Array, calm: float) -> str:
    piece = round(2 * RATE_HZ)
    start = int(np.argmax(after(t_s)))
    squared = [error[k : k + piece] ** 2 for k in range(start, len(error) - piece, piece)]
    levels = [
        np.sqrt(np.mean(values[np.isfinite(values)])) if np.isfinite(values).any() else np.inf for values in squared
    ]
    bad = [k for k, level in enumerate(levels) if not level < BACK * calm]
    if not bad:
        return "0"
    return "never" if bad[-1] == len(levels) - 1 else str((bad[-1] + 1) * piece)


def last_words(adapter: Batches) -> str:
    current = adapter.current
    return current.alarm or current.reason or "nothing to say"


def rows(unit: Unit, seeds: int) -> Iterator[list[object]]:
    for name, event in EVENTS.items():
        for seed in range(seeds):
            rng = np.random.default_rng(seed)
            force_N = walk(BEFORE_S + AFTER_S, rng)
            t_s, output_V, force_N = event((*Sensor(rng).read(force_N), force_N), rng)
            results = {}
            for mode in ("none", "improved"):
                adapter = unit.adapter(mode)
                results[mode] = adapter.advance(t_s, output_V).estimate - force_N
            calm = rmse(results["improved"][~after(t_s)], np.zeros(int((~after(t_s)).sum())))
            last = t_s >= t_s[-1] - 60.0
            ends = [rmse(results[mode][last], np.zeros(int(last.sum()))) for mode in ("none", "improved")]
            yield [name, seed, calm, *ends, samples_until_back(t_s, results["improved"], calm), last_words(adapter)]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one seed instead of three")
    random = np.random.default_rng(9)
    force = walk(180.0, random)
    gait = calibrate(*Sensor(random).read(force), force, RATE_HZ, NetworkConfig(hidden=(40, 20), max_epochs=60))
    header = ["event", "seed", "before [N]", "last minute, no adaptation [N]", "last minute, improved [N]"]
    print_markdown(
        [*header, "samples until back", "what it says at the end"],
        rows(gait, 1 if parser.parse_args().quick else 3),
    )
