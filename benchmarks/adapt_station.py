"""Units that the station calibrates, then used otherwise: is the drift followed, and is there an alarm without one?

The units are twins, pressed by the station's own profile of random presses and calibrated without labels. The use is
cyclic: presses of a machine, of a person, or the station's own profile again.

python benchmarks/adapt_station.py [--seeds FIRST LAST]
"""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from adapt_common import print_markdown

from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.network.training import fit_network
from softcal.core.profiles import random_presses, source_profile, unit_profile
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.simulated_lot import DEPTH_MM, draw_twins
from softcal.core.twin.simulate import Twin, simulate
from softcal.core.unit.calibrate import UnitProblem, calibrate
from softcal.core.unit.calibration import Calibration
from softcal.core.unit.estimate import estimate
from softcal.core.unit.source_model import SourceModel, make_source_model
from softcal.core.use.adapter import Adapter

HOURS = 0.6
PIECES = 200
"""After each of so many the alarm is looked at."""

Use = Callable[[float, float, np.random.Generator], Array]


def machine(seconds: float, rate_Hz: float, rng: np.random.Generator) -> Array:
    """Stage position in mm: presses of 3 mm in 1 s, one every 3 s, each like the other."""
    phase = (np.arange(round(seconds * rate_Hz)) / rate_Hz / 3.0) % 1.0
    return np.asarray(0.85 * DEPTH_MM * np.interp(phase, [0.0, 0.2, 0.45, 0.65, 1.0], [0.0, 1.0, 1.0, 0.0, 0.0]))


def person(seconds: float, rate_Hz: float, rng: np.random.Generator) -> Array:
    """The same by a person: depth and time differ by 4 %."""
    count = int(seconds) + 2
    lengths = np.maximum(8, 3.0 * rate_Hz * (1 + 0.04 * rng.normal(size=count))).round().astype(int)
    depths = 0.8 * DEPTH_MM * np.clip(1 + 0.04 * rng.normal(size=count), 0.5, 1.2)
    n = round(seconds * rate_Hz)
    index = np.repeat(np.arange(count), lengths)[:n]
    phase = (np.arange(n) - np.concatenate([[0], np.cumsum(lengths)])[index]) / lengths[index]
    return np.asarray(depths[index] * np.interp(phase, [0.0, 0.2, 0.45, 0.65, 1.0], [0.0, 1.0, 1.0, 0.0, 0.0]))


def profile_again(seconds: float, rate_Hz: float, rng: np.random.Generator) -> Array:
    """The station's own random presses, drawn anew."""
    return random_presses(rng, seconds, DEPTH_MM).sample(rate_Hz)[1][: round(seconds * rate_Hz)]


USES: dict[str, Use] = {"machine": machine, "person": person, "station profile": profile_again}


@dataclass(frozen=True, eq=False)
class StationUnit:
    """A unit calibrated by the station without labels."""

    model: SourceModel
    calibration: Calibration
    recording: OutputRecording
    twin: Twin

    def adapter(self) -> Adapter:
        """Return a fresh adapter."""
        return Adapter(self.model.network, self.calibration, self.recording)


def station_unit(seed: int, unit_s: float = 150.0) -> StationUnit:
    """Press and calibrate a source and one unit of a lot."""
    rng = np.random.default_rng(seed)
    source_twin, twin = draw_twins(rng, 2)
    rate_Hz = twin.metadata.sample_rate_Hz
    t_s, stage_mm = source_profile(rng, 200.0, DEPTH_MM).sample(rate_Hz)
    force_N, output_V = simulate(source_twin, t_s, stage_mm, rng)
    source = LabelledRecording(OutputRecording("S0", t_s, output_V, rate_Hz, stage_mm=stage_mm), force_N)
    model = make_source_model(source, fit_network(source, NetworkConfig(hidden=(32, 16), max_epochs=30)).network)
    t_s, stage_mm = unit_profile(rng, unit_s, DEPTH_MM).sample(rate_Hz)
    recording = OutputRecording("U1", t_s, simulate(twin, t_s, stage_mm, rng)[1], rate_Hz, stage_mm=stage_mm)
    return StationUnit(model, calibrate(UnitProblem(model, recording, None)), recording, twin)


def rows(seeds: range) -> Iterator[list[object]]:
    for seed in seeds:
        unit = station_unit(seed)
        rate_Hz = unit.twin.metadata.sample_rate_Hz
        for name, use in USES.items():
            rng = np.random.default_rng([seed, 7])
            stage_mm = use(3600 * HOURS, rate_Hz, rng)
            t_s = np.arange(len(stage_mm)) / rate_Hz
            force_N, clean_V = simulate(unit.twin, t_s, stage_mm, rng)
            for drift, size in (("none", 0.0), ("shift and gain", 1.0)):
                # It begins after the first third: a first use is taken to be without drift.
                share = size * np.clip(3 * t_s / t_s[-1] - 1, 0, 1)
                output_V = clean_V * (1 - 0.1 * share) + 0.15 * np.std(clean_V) * share
                yield [seed, name, drift, *follow(unit, t_s, output_V, force_N)]


def follow(unit: StationUnit, t_s: Array, output_V: Array, force_N: Array) -> list[object]:
    """Return the errors over the last third, the share of rows under an alarm, and the last words."""
    adapter, alarmed, estimates = unit.adapter(), 0, []
    for piece in np.array_split(np.arange(len(t_s)), PIECES):
        estimates.append(adapter.advance(t_s[piece], output_V[piece]).estimate)
        alarmed += adapter.current.alarm != ""
    recording = OutputRecording("U1", t_s, output_V, unit.recording.sample_rate_Hz)
    still = estimate(unit.model.network, unit.calibration, recording).estimate
    last = slice(2 * len(t_s) // 3, None)
    before, after = (rmse(values[last], force_N[last]) for values in (still, np.concatenate(estimates)))
    current = adapter.current
    said = current.alarm or current.reason or current.verdict
    return [before, after, after / before, 100 * alarmed / PIECES, said]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs=2, default=(100, 104), metavar=("FIRST", "LAST"))
    header = ["seed", "use", "drift", "no adaptation [N]", "improved [N]", "ratio", "under alarm [%]", "at the end"]
    print_markdown(header, rows(range(*parser.parse_args().seeds)))
