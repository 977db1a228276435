"""Speed: estimates per second through f∘γ, seconds and memory to fit one map, and what a command costs to start.

python benchmarks/speed.py estimate|fit|start|press|calibrate_unit|train [--quick]
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
import tracemalloc
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from unittest import mock

import numpy as np
import ot
from common.command import Commands, median_s
from common.tables import print_table

from softcal.app.registry.unit import source_state
from softcal.core.maps.affine_map import AffineMap
from softcal.core.maps.choose import choose_map
from softcal.core.maps.interface import FitProblem
from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.network.training import fit_network, validation_blocks
from softcal.core.operation.adapter import AdaptConfig, Adapter
from softcal.core.profiles import unit_profile
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.simulated_lot import draw_twins
from softcal.core.twin.simulate import simulate
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.estimate import estimate as estimated
from softcal.core.unit.health import OutputLimits, run_lengths
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import make_source_model
from softcal.core.unit.state import UnitState
from softcal.core.unit.unit_problem import UnitProblem
from softcal.core.windows import TAPS, windows
from softcal.station.bench.bench import open_simulated_bench
from softcal.station.simulated.wire import PtyEnd
from softcal.station.tasks.acquisition import record

SIZES = (TAPS, 120, 70, 35, 1)
RATE_HZ = 50.0
REPEATS = 7
GAIN, OFFSET_V = 1.2, 0.05


def estimate(options: argparse.Namespace) -> None:
    """Estimates per second through f∘γ in batch and streaming, and where the time goes.

    Recording and weights are made up; the network is the paper's 15-120-70-35-1, the map the catalogue's affine one.
    """
    count = 40_000 if options.quick else 400_000
    rng = np.random.default_rng(0)
    network, recording = random_network(rng), random_recording(rng, count)
    calibration = random_calibration(network, recording.part(0, 20_000))
    whole_s = median_s(lambda: estimated(network, calibration, recording), REPEATS)
    print(f"batch: {count / whole_s:,.0f} windows/s ({count:,} windows, median of {REPEATS}; target 500,000)\n")
    print_profile(network, calibration, recording, whole_s)
    print_streaming(network, calibration, recording.part(0, 3_000))


def print_profile(network: Network, calibration: UnitState, recording: OutputRecording, whole_s: float) -> None:
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
    seconds = {name: median_s(step, REPEATS) for name, step in steps.items()}
    seconds["flags and the rest"] = max(whole_s - sum(seconds.values()), 0.0)
    seconds["*floor: the network's matrix products alone*"] = products_alone_s(network, len(mapped))
    rows = (
        (name, f"{1e3 * step_s:.1f}", f"{step_s / whole_s:.0%}", f"{1e9 * step_s / len(recording):.0f}")
        for name, step_s in seconds.items()
    )
    print_table("step | ms | share | ns per window", rows)


def products_alone_s(network: Network, count: int) -> float:
    """Return the seconds of the float32 matrix products of f, data in cache: what no arrangement goes below."""
    return median_s(matrix_products(network, count), REPEATS)


def matrix_products(network: Network, count: int) -> Callable[[], None]:
    """Return what computes the float32 matrix products of f for so many windows, and nothing else."""
    block = count if count < 4096 else 2048
    pairs = [
        (np.ones((block, w.shape[0]), np.float32), w.astype(np.float32), np.empty((block, w.shape[1]), np.float32))
        for w in network.weights
    ]

    def products() -> None:
        for _ in range(count // block):
            for left, right, out in pairs:
                np.matmul(left, right, out=out)

    return products


def cpu_of_s(work: Callable[[], None]) -> float:
    """Return the CPU of one of ten calls in a row."""
    begun_s = time.process_time()
    for _ in range(10):
        work()
    return (time.process_time() - begun_s) / 10


def print_streaming(network: Network, calibration: UnitState, recording: OutputRecording) -> None:
    estimator, taken_s = Adapter(network, calibration, recording, AdaptConfig("none")), []
    for t_s, output in zip(recording.t_s, recording.output, strict=True):
        start_s = time.perf_counter()
        estimator.step(t_s, output)
        taken_s.append(time.perf_counter() - start_s)
    middle, late = 1e3 * np.quantile(taken_s, (0.5, 0.99))
    print(f"streaming: {middle:.3f} ms per sample, 99th percentile {late:.3f} ms (target 1 ms)")


def random_network(rng: np.random.Generator) -> Network:
    weights = tuple(rng.normal(0, np.sqrt(2 / a), (a, b)) for a, b in zip(SIZES[:-1], SIZES[1:], strict=True))
    return Network(weights, tuple(rng.normal(0, 0.1, b) for b in SIZES[1:]), 1.0, 0.3, 2.0, 1.0)


def random_recording(rng: np.random.Generator, count: int) -> OutputRecording:
    t_s = np.arange(count) / RATE_HZ
    output_V = 1.0 + 0.3 * np.sin(0.7 * t_s) * np.sin(0.11 * t_s) + rng.normal(0, 0.002, count)
    return OutputRecording("U1", t_s, output_V, RATE_HZ)


def random_calibration(network: Network, recording: OutputRecording) -> UnitState:
    source = LabelledRecording(
        recording, np.concatenate([np.zeros(TAPS - 1), network.evaluate(windows(recording.output))])
    )
    state = source_state(source, network)
    fitted = replace(state.fitted, unit_map=AffineMap(1.02, -0.01), output_limits=OutputLimits(-np.inf, np.inf, 200))
    return replace(state, fit=replace(state.fit, fitted=fitted))


def fit(options: argparse.Namespace) -> None:
    """Seconds and memory to fit one map, against POT's exact transport on the same windows in the same run."""
    network = fit_network(unit(4000, 1, 1.0, 0.0), NetworkConfig(max_epochs=60)).network
    versus_pot(network, 1500 if options.quick else 6250)
    growth(network)


def versus_pot(network: Network, count: int) -> None:
    """Time and error of the default and of EMDTransport on equal windows."""
    problem, test = pair(network, count), unit(4000, 9, GAIN, OFFSET_V)
    ours_s = fit_s(network, count)
    chosen = choose_map(problem)
    transport = ot.da.EMDTransport(max_iter=100_000_000)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        windows_of_both = {"Xs": np.array(problem.target.windows), "Xt": np.array(problem.source.windows)}
        theirs_s = median_s(lambda: transport.fit(**windows_of_both))
        moved = transport.transform(Xs=np.array(test.windows))
    rows = [
        (
            f"softcal default ({chosen.family})",
            ours_s,
            rmse(network.evaluate(chosen.unit_map.apply(test.windows)), test.window_reference),
        ),
        ("ot.da.EMDTransport", theirs_s, rmse(network.evaluate(moved), test.window_reference)),
    ]
    print(f"{count} x {count} windows, {theirs_s / ours_s:.0f} times faster:\n")
    print_table(("method", "fit, s", "error, N"), rows)


def growth(network: Network) -> None:
    """Time and peak memory of the default against the number of samples, and the slope of log time over log samples."""
    counts, rows = (3125, 6250, 12_500, 25_000, 50_000), []
    for count in counts:
        problem = pair(network, count)
        tracemalloc.start()
        choose_map(problem)
        peak_MB = tracemalloc.get_traced_memory()[1] / 1e6
        tracemalloc.stop()
        rows.append((count, fit_s(network, count), peak_MB))
    slope = float(np.polyfit(np.log(counts), np.log([row[1] for row in rows]), 1)[0])
    print(f"Growth with samples, slope {slope:.2f} (1 is linear):\n")
    print_table(("windows a side", "fit, s", "peak, MB"), rows)


def fit_s(network: Network, count: int) -> float:
    """Median wall time of a map, on recordings that nothing was computed of before."""
    fresh = iter([pair(network, count) for _ in range(5)])
    return median_s(lambda: choose_map(next(fresh)), 5)


def pair(network: Network, count: int) -> FitProblem:
    """Source and unit of so many windows, pressed independently."""
    return FitProblem(unit(count + 14, 1, 1.0, 0.0), network, unit(count + 14, 2, GAIN, OFFSET_V).unlabelled)


def unit(count: int, seed: int, gain: float, offset_V: float) -> LabelledRecording:
    """Random presses to 0.5 ... 3 N at random speeds through a bending, slightly noisy sensor."""
    rng, parts, length = np.random.default_rng(seed), [], 0
    while length < count:
        peak, up, down, rest = rng.uniform(0.5, 3.0), *rng.integers(10, 60, 3)
        parts += [np.linspace(0, peak, up), np.linspace(peak, 0, down), np.zeros(rest)]
        length += up + down + rest
    force_N = np.concatenate(parts)[:count]
    output_V = 0.5 + offset_V + gain * (0.1 * force_N + 0.02 * force_N**2) + rng.normal(0, 0.0008, count)
    return LabelledRecording(OutputRecording(f"U{seed}", np.arange(count) / 50.0, output_V, 50.0), force_N)


def start(options: argparse.Namespace) -> None:
    """CPU and memory of commands that people wait for, beside `python -c pass` and the libraries they stand on.

    Every row is the least of several runs in a process of its own, the rows in turn, so that all have the same machine.
    The estimate is of 1,000 rows, with a network of 16 and 8 nodes.
    """
    with tempfile.TemporaryDirectory() as name:
        registry, recording, out = _calibrated_unit(Path(name))
        softcal, where = str(Path(sys.executable).with_name("softcal")), ["--registry", registry]
        commands = {
            "python -c pass": [sys.executable, "-c", "pass"],
            "*import numpy*": [sys.executable, "-c", "import numpy"],
            "*import sqlalchemy*": [sys.executable, "-c", "import sqlalchemy"],
            "*import pandas*": [sys.executable, "-c", "import pandas"],
            "softcal --help": [softcal, "--help"],
            "softcal estimate --help": [softcal, "estimate", "--help"],
            "softcal registry list": [softcal, "registry", "list", *where],
            "softcal estimate": [
                softcal,
                "estimate",
                "--serial",
                "S2",
                recording,
                "--out",
                out,
                "--registry",
                registry,
            ],
        }
        costs: dict[str, list[tuple[float, float]]] = {name: [] for name in commands}
        for _ in range(3 if options.quick else 15):
            for name, command in commands.items():
                costs[name].append(_cost(command))
    min_s = {name: min(runs) for name, runs in costs.items()}
    floor_s = min_s["python -c pass"][0]
    rows = ((name, cpu_s, cpu_s / floor_s, f"{peak_MB:.0f}") for name, (cpu_s, peak_MB) in min_s.items())
    print_table("command | CPU, s | times python -c pass | memory, MB", rows)


def press(options: argparse.Namespace) -> None:
    """CPU of one simulated press over its serial lines, beside what no simulation of it goes below, in one run.

    The floor is the twin over all instants at once, and every line written to a pseudo terminal and read from it.
    """
    twin = draw_twins(np.random.default_rng(7), 2)[1]
    seconds, rng = (15.0, 150.0)[not options.quick], np.random.default_rng(3)
    with open_simulated_bench(twin, 5) as (bench, station):
        record(bench, "warm", unit_profile(rng, 5.0), with_reference=True)
        lines, write = [], PtyEnd.write

        def counted(end: PtyEnd, content: bytes) -> None:
            lines.append(content)
            write(end, content)

        with mock.patch.object(PtyEnd, "write", counted):
            begun_s, simulated_s = time.process_time(), station.world.now_s()
            recording = record(bench, "U1", unit_profile(rng, seconds), with_reference=True)
            press_s, simulated_s = time.process_time() - begun_s, station.world.now_s() - simulated_s
    begun_s = time.process_time()
    simulate(twin, np.arange(round(simulated_s * 130.0)) / 130.0, np.zeros(round(simulated_s * 130.0)))
    twin_s = time.process_time() - begun_s
    floor_s = twin_s + over_a_terminal_s(lines)
    rows = [
        ("one press", len(recording.output), len(lines), press_s, press_s / floor_s),
        ("*twin at once, and every line over a pty*", len(recording.output), len(lines), floor_s, 1.0),
    ]
    print_table("what | rows | lines | CPU, s | times the floor", rows)


def over_a_terminal_s(lines: Sequence[bytes]) -> float:
    """Return the CPU of writing lines to a pseudo terminal and of reading each of them."""
    end = PtyEnd()
    host = os.open(end.port, os.O_RDWR | os.O_NONBLOCK)
    begun_s = time.process_time()
    for line in lines:
        end.write(line)
        os.read(host, 65536)
    taken_s = time.process_time() - begun_s
    os.close(host)
    end.hang_up()
    return taken_s


def calibrate_unit(options: argparse.Namespace) -> None:
    """Least CPU of one more unit of a batch, beside the network's matrix products for its samples in the same run."""
    source = unit(8_500, 1, 1.0, 0.0)
    network = fit_network(source, NetworkConfig(max_epochs=2 if options.quick else 15)).network
    model, rows = make_source_model(source, network, method=Method()), []
    for count in (1_250, 3_200):
        taken_s = []
        for seed in range(2, 6 if options.quick else 16):
            recording = unit(count, seed, GAIN, OFFSET_V).unlabelled
            begun_s = time.process_time()
            calibrate(UnitProblem(model, recording))
            taken_s.append(time.process_time() - begun_s)
        products = matrix_products(network, count)
        floor_s = min(cpu_of_s(products) for _ in range(20))
        rows.append((count, 1e3 * min(taken_s), 1e3 * floor_s, min(taken_s) / floor_s))
    print_table("samples | a unit, ms | matrix products of f, ms | times", rows)


def train(options: argparse.Namespace) -> None:
    """CPU to train f at the paper's size, beside a plain torch loop until its error is no larger.

    The error is that on the held-out blocks, which stop both trainings where it does not fall any more.
    """
    source, config = unit(5_000 if options.quick else 25_000, 1, 1.0, 0.0), NetworkConfig()
    fit_network(unit(2_000, 2, 1.0, 0.0), replace(config, max_epochs=1))
    begun_s = time.process_time()
    fit = fit_network(source, config)
    taken_s = time.process_time() - begun_s
    rows: list[tuple[object, ...]] = [("softcal", taken_s, sum(fit.epochs), fit.validation_rmse)]
    begun_s = time.process_time()
    epochs, error = train_plainly(source, config, fit.validation_rmse)
    rows.append(("plain torch loop", time.process_time() - begun_s, epochs, error))
    print_table("training | CPU s | epochs | error, held-out blocks, N", rows)
    print(f"softcal takes {taken_s / float(str(rows[1][1])):.2f} of the plain loop's CPU")


def train_plainly(source: LabelledRecording, config: NetworkConfig, enough: float) -> tuple[int, float]:
    """Train as a tutorial of torch does: `DataLoader`, `Sequential`, Adam; return epochs and the best error."""
    import torch
    from torch.utils.data import DataLoader, TensorDataset

    torch.manual_seed(config.seed)
    torch.set_num_threads(1)
    blocks = validation_blocks(len(source.windows), config.validation_share)
    held_out = torch.from_numpy(blocks)
    # As softcal does: what shares samples with a held-out window is not trained on.
    trained_on = torch.from_numpy(np.convolve(blocks, np.ones(2 * TAPS + 1), mode="same") < 0.5)
    x, y = (torch.from_numpy(values).float() for values in (source.windows, source.window_reference[:, None]))
    x, scale = (x - x.mean()) / x.std(), float(y.std())
    y = (y - y.mean()) / scale
    sizes = (TAPS, *config.hidden, 1)
    layers = [part for a, b in pairwise(sizes) for part in (torch.nn.Linear(a, b), torch.nn.ReLU())][:-1]
    model = torch.nn.Sequential(*layers)
    optimiser = torch.optim.Adam(model.parameters(), lr=config.learning_rate)
    schedule = torch.optim.lr_scheduler.ReduceLROnPlateau(optimiser, factor=0.5, patience=config.patience // 3)
    batches = DataLoader(TensorDataset(x[trained_on], y[trained_on]), batch_size=config.batch, shuffle=True)
    best, best_epoch, epoch = np.inf, 0, 0
    while best > enough and epoch < config.max_epochs and epoch - best_epoch < config.patience:
        epoch += 1
        for inputs, labels in batches:
            optimiser.zero_grad()
            torch.nn.functional.mse_loss(model(inputs), labels).backward()
            optimiser.step()
        with torch.no_grad():
            error = float(torch.nn.functional.mse_loss(model(x[held_out]), y[held_out]) ** 0.5) * scale
        schedule.step(error)
        best, best_epoch = min((best, best_epoch), (error, epoch))
    return epoch, best


MEASURE = """import os, sys
quiet = [(os.POSIX_SPAWN_OPEN, number, os.devnull, os.O_WRONLY, 0) for number in (1, 2)]
_, status, used = os.wait4(os.posix_spawn(sys.argv[1], sys.argv[1:], os.environ, file_actions=quiet), 0)
print(status, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)
"""
"""A process begins with the peak memory of the one that starts it: a small one does."""


def _cost(command: Sequence[str]) -> tuple[float, float]:
    """CPU in s and peak memory in MB of one run."""
    small = [sys.executable, "-I", "-S", "-c", MEASURE, *command]
    status, cpu_s, peak_MB = subprocess.run(small, capture_output=True, text=True, check=True).stdout.split()
    if status != "0":
        raise RuntimeError(f"{' '.join(command)} failed")
    return float(cpu_s), float(peak_MB)


def _calibrated_unit(folder: Path) -> tuple[str, str, str]:
    """Calibrate a unit S2 by the commands; return the registry's URL, 1,000 further rows of it, and a file to write."""
    registry, tables = f"sqlite:///{folder / 'registry.db'}", []
    for serial, samples, seed, gain in (("S1", 1500, 1, 1.0), ("S2", 1500, 2, GAIN), ("new", 1000, 3, GAIN)):
        recorded_unit = unit(samples, seed, gain, 0.0)
        table = folder / f"{serial}.csv"
        columns = np.column_stack(
            [recorded_unit.unlabelled.t_s, recorded_unit.unlabelled.output, recorded_unit.reference]
        )
        np.savetxt(table, columns, delimiter=",", header="t_s,output,reference", comments="")
        tables.append(str(table))
    softcal, lot = str(Path(sys.executable).with_name("softcal")), str(folder / "lot")
    names = ["--source", "S1", "--output-column", "output", "--reference-column", "reference", "--time-column", "t_s"]
    subprocess.run([softcal, "import", *tables[:2], *names, "--sample-rate", "50", "--out", lot], check=True)
    small = ["--hidden", "16,8", "--no-own", "--registry", registry]
    subprocess.run([softcal, "batch", lot, *small], stdout=subprocess.DEVNULL, check=False)
    return registry, tables[2], str(folder / "estimate.csv")


def main() -> None:
    every = Commands(__doc__)
    every.add(estimate, "a tenth of the samples")
    every.add(fit, "POT at 1,500 windows instead of 6,250")
    every.add(start, "3 runs a command instead of 15")
    every.add(press, "15 s of a press instead of 150 s")
    every.add(calibrate_unit, "4 units instead of 14")
    every.add(train, "5,000 samples instead of 25,000")
    every.run()


if __name__ == "__main__":
    main()
