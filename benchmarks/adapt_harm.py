"""How often following the drift ends worse than leaving the map alone: many sensors, uses, drifts and seeds.

python benchmarks/adapt_harm.py [--quick] [--seeds N] [--activity NAME]
"""

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from adapt_common import print_markdown
from scipy.stats import spearmanr
from simulated_use import ACTIVITIES, CURVES, Activity, Style, cycles, read, station

from softcal.app.use.adapt import source_calibration
from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.network.training import fit_network
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.unit.calibration import Calibration
from softcal.core.unit.estimate import estimate
from softcal.core.use.adapter import AdaptConfig, Adapter

SAMPLES = 15_000
CALIBRATION = 5_000
SHOWN = 12
"""Worst runs that are listed."""

HARM = 1.02
"""A run that ends with more than this many times the error without adaptation was harmed."""

SCORES = ("precision", "recall")

Drift = Callable[[Array, np.random.Generator], tuple[Array, Array]]
Use = Callable[[Activity, int, np.random.Generator], Array]


def none(x: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    return np.ones_like(x), np.zeros_like(x)


def ages(x: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Gain falls or rises by up to a fifth, the offset creeps with it."""
    return 1 + rng.choice([-1, 1]) * rng.uniform(0.05, 0.2) * x, rng.normal(0, 0.15) * np.log1p(5 * x)


def creeps(x: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    return np.ones_like(x), rng.choice([-1, 1]) * rng.uniform(0.05, 0.3) * np.log1p(9 * x) / np.log(10)


def is_reseated(x: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    is_after = x > rng.uniform(0.3, 0.7)
    return np.where(is_after, 1 + rng.normal(0, 0.05), 1.0), np.where(is_after, rng.normal(0, 0.15), 0.0)


def wanders(x: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """There and back, as temperature does."""
    wave = np.sin(2 * np.pi * (x * rng.uniform(0.5, 2.0) + rng.random()))
    return 1 + 0.05 * (wave - wave[0]), 0.1 * (wave - wave[0])


DRIFTS: Mapping[str, Drift] = {
    "none": none,
    "ages": ages,
    "creeps": creeps,
    "re-seated": is_reseated,
    "wanders": wanders,
}


def same(activity: Activity, n: int, rng: np.random.Generator) -> Array:
    return cycles(activity, n, rng)


def irregular(activity: Activity, n: int, rng: np.random.Generator) -> Array:
    return cycles(activity, n, rng, Style(scatter=0.12))


def changes(style: Style) -> Use:
    """Return the use that changes after a third."""

    def use(activity: Activity, n: int, rng: np.random.Generator) -> Array:
        return np.concatenate([cycles(activity, n // 3, rng), cycles(activity, n - n // 3, rng, style)])

    return use


def slowly_harder(activity: Activity, n: int, rng: np.random.Generator) -> Array:
    return cycles(activity, n, rng) * np.linspace(1.0, 1.3, n)


def stands(activity: Activity, n: int, rng: np.random.Generator) -> Array:
    """A constant load with a little sway."""
    sway = np.convolve(rng.normal(size=n + 99), np.ones(100) / 100, mode="valid")
    return np.asarray(0.5 + 0.2 * sway)


def rests(activity: Activity, n: int, rng: np.random.Generator) -> Array:
    return np.zeros(n)


def runs(activity: Activity, n: int, rng: np.random.Generator) -> Array:
    return cycles(activity, n, rng, Style(1.3, 1.5, 0.06))


def other(activity: Activity, n: int, rng: np.random.Generator) -> Array:
    """The wave of the next activity, at the rate and pace of this one."""
    names = list(ACTIVITIES)
    place = next(k for k, name in enumerate(names) if ACTIVITIES[name].wave is activity.wave)
    wave = ACTIVITIES[names[(place + 1) % len(names)]].wave
    return cycles(Activity(wave, activity.cycle_s, activity.rate_Hz), n, rng)


def day(activity: Activity, n: int, rng: np.random.Generator) -> Array:
    """One activity after another, the calibrated one most often."""
    parts: list[Array] = []
    while sum(map(len, parts)) < n:
        use = [same, stands, same, runs, rests, other][int(rng.integers(6))]
        parts.append(use(activity, int(rng.uniform(0.02, 0.15) * n), rng))
    return np.concatenate(parts)[:n]


def is_replaced(activity: Activity, n: int, rng: np.random.Generator) -> Array:
    return np.concatenate([same(activity, n // 3, rng), other(activity, n - n // 3, rng)])


USES: Mapping[str, Use] = {
    "the same": same,
    "irregular": irregular,
    "30 % harder": changes(Style(load=1.3)),
    "30 % lighter": changes(Style(load=0.7)),
    "1.4 times as fast": changes(Style(pace=1.4)),
    "runs: harder and faster": changes(Style(1.3, 1.5, 0.06)),
    "another activity": is_replaced,
    "a day of several": day,
    "slowly 30 % harder": slowly_harder,
}


@dataclass(frozen=True, eq=False)
class Bench:
    """A kind of sensor whose f knows the whole range of loads."""

    curve: str
    network: Network
    calibration: Calibration


def make_bench(curve: str, rate_Hz: float) -> Bench:
    rng = np.random.default_rng(5)
    uses = [
        cycles(Activity(a.wave, a.cycle_s, rate_Hz), 1500, rng, Style(1.1, scatter=0.2)) for a in ACTIVITIES.values()
    ]
    load = np.concatenate([station(4000, rate_Hz, rng), *uses])
    output = OutputRecording("source", np.arange(len(load)) / rate_Hz, read(curve, load, rate_Hz, rng), rate_Hz)
    source = LabelledRecording(output, load)
    network = fit_network(source, NetworkConfig(hidden=(32, 16), max_epochs=40)).network
    return Bench(curve, network, source_calibration(source, network))


def adapter(bench: Bench, load: Array, rate_Hz: float, rng: np.random.Generator) -> Adapter:
    """Return an adapter whose unit was calibrated under a given load."""
    output = read(bench.curve, load, rate_Hz, rng)
    recording = OutputRecording("unit", np.arange(len(load)) / rate_Hz, output, rate_Hz)
    return Adapter(bench.network, bench.calibration, recording)


@dataclass(frozen=True)
class Run:
    """One stream: the use, the drift, and the errors over it and over its last third, unmoved and improved.

    Args:
        unit: activity and kind of sensor.
        promised: predicted error before the stream.
        predicted: median predicted error over the last third.
        is_alarmed: whether a recalibration was called for over most of it.
    """

    unit: str
    use: str
    drift: str
    whole: tuple[float, float]
    last: tuple[float, float]
    promised: float
    predicted: float
    is_alarmed: bool

    @property
    def is_bad(self) -> bool:
        """Whether the last third was estimated with more than the error at which recalibration is due."""
        return self.last[1] > AdaptConfig().method.doubt.alarm_ratio * self.promised

    @property
    def worse(self) -> float:
        """Error over the error without adaptation."""
        return self.whole[1] / self.whole[0]

    @property
    def ends_worse(self) -> float:
        """The same over the last third."""
        return self.last[1] / self.last[0]


def follow(bench: Bench, name: str, case: tuple[str, str, bool], seed: int) -> Run:
    use, drift, is_on_station = case
    activity = ACTIVITIES[name]
    rng = np.random.default_rng([seed, *use.encode(), *drift.encode()])
    load = USES[use](activity, SAMPLES, rng)
    gain, shift = DRIFTS[drift](np.linspace(0, 1, SAMPLES), rng)
    output = read(bench.curve, load, activity.rate_Hz, rng, gain, shift)
    if is_on_station:
        calibrated = station(CALIBRATION, activity.rate_Hz, rng)
    else:
        calibrated = cycles(activity, CALIBRATION, rng)
    t_s = np.arange(SAMPLES) / activity.rate_Hz
    following = adapter(bench, calibrated, activity.rate_Hz, rng)
    promised, said, pieces = following.current.predicted_rmse, [], []
    for piece in np.array_split(np.arange(SAMPLES), 60):
        pieces.append(following.advance(t_s[piece], output[piece]).estimate)
        said.append((following.current.predicted_rmse, following.current.alarm != ""))
    still = estimate(bench.network, bench.calibration, OutputRecording("unit", t_s, output, activity.rate_Hz)).estimate
    errors = [still - load, np.concatenate(pieces) - load]
    zero = np.zeros(SAMPLES)
    last = slice(2 * SAMPLES // 3, None)
    whole, ends = ([rmse(e[part], zero[part]) for e in errors] for part in (slice(None), last))
    predicted, alarmed = np.median(np.array(said[40:], dtype=float), axis=0)
    unit = f"{name}, {bench.curve}{', calibrated on the station' if is_on_station else ''}"
    return Run(unit, use, drift, (whole[0], whole[1]), (ends[0], ends[1]), promised, float(predicted), bool(alarmed))


def all_runs(names: Sequence[str], seeds: int, is_quick: bool) -> Iterator[Run]:
    curves = list(CURVES)[: 1 if is_quick else None]
    for name in names:
        for curve in curves:
            bench = make_bench(curve, ACTIVITIES[name].rate_Hz)
            for seed in range(seeds):
                # Every third unit was calibrated on the station, under another programme than its use.
                for k, (use, drift) in enumerate((u, d) for u in USES for d in DRIFTS):
                    yield follow(bench, name, (use, drift, (k + seed) % 3 == 2), seed)


def summary(runs: list[Run]) -> list[object]:
    whole, last = (np.array([getattr(run, name) for run in runs]) for name in ("worse", "ends_worse"))
    harmed = 100 * float(np.mean(whole > HARM))
    ended = 100 * float(np.mean(last > HARM))
    return [
        len(runs),
        float(np.median(whole)),
        harmed,
        float(whole.max()),
        float(np.median(last)),
        ended,
        float(last.max()),
    ]


def print_forecasts(runs: list[Run]) -> None:
    """Print how the predicted error over the last third compares with the true one, and the alarm with what was due."""
    true, predicted = (np.array([value(run) for run in runs]) for value in (lambda r: r.last[1], lambda r: r.predicted))
    log_ratio = np.log(true / predicted)
    bad, alarmed = (np.array([getattr(run, name) for run in runs]) for name in ("is_bad", "is_alarmed"))
    hits = int(np.sum(bad & alarmed))
    print_markdown(
        [
            "runs",
            "rank correlation",
            "true / predicted: 10 %",
            "median",
            "90 %",
            "due",
            "alarms",
            "precision",
            "recall",
        ],
        [
            [
                len(runs),
                float(spearmanr(true, predicted).statistic),
                *np.exp(np.quantile(log_ratio, (0.1, 0.5, 0.9))).tolist(),
                int(bad.sum()),
                int(alarmed.sum()),
                hits / max(1, int(alarmed.sum())),
                hits / max(1, int(bad.sum())),
            ]
        ],
    )


def main(names: Sequence[str], seeds: int, is_quick: bool) -> None:
    runs = list(all_runs(names, seeds, is_quick))
    header = ["runs", "median ratio", f"share above {HARM:g} [%]", "worst"]
    header += ["median, last third", f"share above {HARM:g}, last third [%]", "worst, last third"]
    for title, key in (("use", lambda run: run.use), ("drift", lambda run: run.drift)):
        names = dict.fromkeys(map(key, runs))
        print_markdown([title, *header], [[n, *summary([run for run in runs if key(run) == n])] for n in names])
        print()
    print_markdown(["all", *header], [["all", *summary(runs)]])
    print()
    print_forecasts(runs)
    print()
    worst = sorted(runs, key=lambda run: -run.worse)[:SHOWN]
    header = ["worst runs", "use", "drift", "ratio", "last third", "alarm", "no adaptation", "improved"]
    rows = [[r.unit, r.use, r.drift, r.worse, r.ends_worse, "yes" if r.is_alarmed else "no", *r.whole] for r in worst]
    print_markdown(header, rows)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one kind of sensor instead of four")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--activity", choices=list(ACTIVITIES), action="append", help="this one only; may be repeated")
    options = parser.parse_args()
    main(options.activity or list(ACTIVITIES), options.seeds, options.quick)
