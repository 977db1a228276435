"""Estimates per second through f∘γ in batch and streaming, and where the time goes.

    python benchmarks/speed_estimate.py [--quick]

Recording and weights are made up; the network is the paper's 15-120-70-35-1, the map the catalogue's affine one.
"""

import argparse
import time
from collections.abc import Callable

import numpy as np

from softcal.core.maps.affine_map import AffineMap
from softcal.core.network.network import Network
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.calibration import Calibration
from softcal.core.unit.estimate import estimate
from softcal.core.unit.health import OutputLimits, run_lengths
from softcal.core.unit.knowledge import known_by
from softcal.core.unit.source_model import make_source_model
from softcal.core.unit.uncertainty import ErrorForecast
from softcal.core.unit.verdict import Decision, Judgement, Verdict
from softcal.core.use.adapter import AdaptConfig, Adapter
from softcal.core.windows import TAPS, windows

SIZES = (TAPS, 120, 70, 35, 1)
RATE_HZ = 50.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a tenth of the samples")
    count = 40_000 if parser.parse_args().quick else 400_000
    rng = np.random.default_rng(0)
    network, recording = made_up_network(rng), made_up_recording(rng, count)
    calibration = made_up_calibration(network, recording.part(0, 20_000))
    whole_s = median_s(lambda: estimate(network, calibration, recording))
    print(f"batch: {count / whole_s:,.0f} windows/s ({count:,} windows, median of 7; target 500,000)\n")
    print_profile(network, calibration, recording, whole_s)
    print_streaming(network, calibration, recording.part(0, 3_000))


def print_profile(network: Network, calibration: Calibration, recording: OutputRecording, whole_s: float) -> None:
    mapped = calibration.unit_map.apply_signal(recording.output)
    interval = calibration.interval
    value = network.evaluate(mapped)
    shape = interval.support.shape(mapped)
    distance = interval.support.distance(shape)
    steps: dict[str, Callable[[], object]] = {
        "map γ": lambda: calibration.unit_map.apply_signal(recording.output),
        "network f": lambda: network.evaluate(mapped),
        "window shape": lambda: interval.support.shape(mapped),
        "distance from support": lambda: interval.support.distance(shape),
        "interval": lambda: interval.half(value, shape, distance),
        "run lengths": lambda: run_lengths(recording.output),
    }
    print("| step | ms | share | ns per window |\n|---|---|---|---|")
    taken = {name: median_s(step) for name, step in steps.items()}
    taken["flags and the rest"] = max(whole_s - sum(taken.values()), 0.0)
    for name, step_s in taken.items():
        print(f"| {name} | {1e3 * step_s:.1f} | {step_s / whole_s:.0%} | {1e9 * step_s / len(recording):.0f} |")
    floor_s = products_alone_s(network, len(mapped))
    print(f"| *floor: the network's matrix products alone* | {1e3 * floor_s:.1f} | {floor_s / whole_s:.0%} | |")


def products_alone_s(network: Network, count: int) -> float:
    """Return the seconds of the float32 matrix products of f, data in cache: what no arrangement goes below."""
    block = 2048
    pairs = [
        (np.ones((block, w.shape[0]), np.float32), w.astype(np.float32), np.empty((block, w.shape[1]), np.float32))
        for w in network.weights
    ]

    def products() -> None:
        for _ in range(count // block):
            for left, right, out in pairs:
                np.matmul(left, right, out=out)

    return median_s(products)


def print_streaming(network: Network, calibration: Calibration, recording: OutputRecording) -> None:
    estimator, taken_s = Adapter(network, calibration, recording, AdaptConfig("none")), []
    for t_s, output in zip(recording.t_s, recording.output, strict=True):
        start_s = time.perf_counter()
        estimator.step(t_s, output)
        taken_s.append(time.perf_counter() - start_s)
    middle, late = 1e3 * np.quantile(taken_s, (0.5, 0.99))
    print(f"\nstreaming: {middle:.3f} ms per sample, 99th percentile {late:.3f} ms (target 1 ms)")


def made_up_network(rng: np.random.Generator) -> Network:
    weights = tuple(rng.normal(0, np.sqrt(2 / a), (a, b)) for a, b in zip(SIZES[:-1], SIZES[1:], strict=True))
    return Network(weights, tuple(rng.normal(0, 0.1, b) for b in SIZES[1:]), 1.0, 0.3, 2.0, 1.0)


def made_up_recording(rng: np.random.Generator, count: int) -> OutputRecording:
    t_s = np.arange(count) / RATE_HZ
    output_V = 1.0 + 0.3 * np.sin(0.7 * t_s) * np.sin(0.11 * t_s) + rng.normal(0, 0.002, count)
    return OutputRecording("U1", t_s, output_V, RATE_HZ)


def made_up_calibration(network: Network, recording: OutputRecording) -> Calibration:
    source = LabelledRecording(
        recording, np.concatenate([np.zeros(TAPS - 1), network.evaluate(windows(recording.output))])
    )
    model = make_source_model(source, network, np.arange(0, len(source.windows), 5))
    return Calibration(
        serial="U1",
        network_id=network.id,
        unit_map=AffineMap(1.02, -0.01),
        interval=model.interval,
        output_limits=OutputLimits(-np.inf, np.inf, 200),
        forecast=ErrorForecast(0.1, 0.08, 0.12),
        decision=Decision(Judgement(Verdict.PASS, ())),
        knowledge=known_by({}, model.method.knowledge),
        evidence={},
        method=model.method,
    )


def median_s(work: Callable[[], object], repeats: int = 7) -> float:
    taken = []
    for _ in range(repeats):
        start_s = time.perf_counter()
        work()
        taken.append(time.perf_counter() - start_s)
    return float(np.median(taken))


if __name__ == "__main__":
    main()
