"""What a few lost samples change: forecast, estimates and map of a unit with planted bad samples, beside those without.

    python benchmarks/lost_samples.py [--seeds N] [--sets eGaIn skin ...]

Measured recordings lose samples as a mask takes them out: 5 at random places, 5 in a row, 20 at random places. The
source stays whole.
"""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from common.map_methods import DATA, NETWORK, egain, insole, skin, taxel
from common.tables import print_table

from softcal.core.network.training import fit_network
from softcal.core.recording import LabelledRecording, Mask, OutputRecording, Rng
from softcal.core.unit.calibrate import fit_unit
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import SourceModel, make_source_model
from softcal.core.unit.unit_problem import UnitProblem

TAXELS = ("taxel_030", "taxel_060", "taxel_135")


def nylon(run: str) -> LabelledRecording:
    """The first quarter of one run of the nylon sensor, before it drifts."""
    import pandas as pd

    table = pd.read_parquet(DATA / f"nylon_drift/{run}.parquet")
    quarter = table[: len(table) // 4]
    output = quarter["output_R_over_R0"].to_numpy(float)
    strain = quarter["strain_norm"].to_numpy(float)
    return LabelledRecording(OutputRecording(run, np.arange(len(quarter)) / 10.0, output, 10.0, "1"), strain, "1")


def pairs(sets: list[str]) -> Iterator[tuple[str, LabelledRecording, list[LabelledRecording]]]:
    """Yield set, source and its units."""
    if "eGaIn" in sets:
        for source, unit in (("S1", "S2"), ("S2", "S1")):
            yield "eGaIn", egain(source), [egain(unit)]
    if "skin" in sets:
        yield "skin", skin("middle").part(0, 2400), [skin(place).part(0, 2400) for place in ("left", "right")]
    if "insole" in sets:
        table = insole("calibration")
        yield "insole, another day", taxel(table, "taxel_001"), [taxel(insole("validation_1"), one) for one in TAXELS]
        yield "insole, in step", taxel(table, "taxel_001"), [taxel(table, one) for one in TAXELS]
    if "nylon" in sets:
        yield "nylon", nylon("sin_20"), [nylon("tri_30"), nylon("mixed_10_20")]


def scattered(count: int) -> Callable[[int, Rng], Mask]:
    """Return what loses so many samples at random places."""

    def lose(samples: int, rng: Rng) -> Mask:
        is_left = np.ones(samples, dtype=bool)
        is_left[rng.choice(samples - 60, count, replace=False) + 30] = False
        return is_left

    return lose


def in_a_row(samples: int, rng: Rng) -> Mask:
    """Lose five samples in a row."""
    is_left = np.ones(samples, dtype=bool)
    start = int(rng.integers(30, samples - 35))
    is_left[start : start + 5] = False
    return is_left


LOSSES = {"5 anywhere": scattered(5), "5 in a row": in_a_row, "20 anywhere": scattered(20)}


def without(recording: OutputRecording, is_left: Mask) -> OutputRecording:
    """Return a recording of the samples that are left."""
    return replace(recording, t_s=recording.t_s[is_left], output=recording.output[is_left])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--sets", nargs="+", default=["eGaIn", "skin", "insole", "nylon"])
    options = parser.parse_args()
    rows: list[list[object]] = []
    for name, source, units in pairs(options.sets):
        trained = fit_network(source, NETWORK)
        model = make_source_model(source, trained.network, trained.validation_rows, method=Method())
        for unit in units:
            rows += ratios(name, model, unit, options.seeds)
    print_table(("set", "unit", "family", "lost", "least", "median", "largest", "true error, largest"), rows)


def ratios(name: str, model: SourceModel, unit: LabelledRecording, seeds: int) -> Iterator[list[object]]:
    """Yield rows of a table: ratios of forecast and of true error with and without a loss, over seeds."""
    whole, _ = fit_unit(UnitProblem(model, unit.unlabelled))
    error = true_error(model, unit, whole.fitted.unit_map)
    for loss, lose in LOSSES.items():
        forecasts, errors = [], []
        for seed in range(seeds):
            part = without(unit.unlabelled, lose(len(unit), np.random.default_rng(seed)))
            fit, _ = fit_unit(UnitProblem(model, part))
            forecasts.append(fit.forecast.rmse / whole.forecast.rmse)
            errors.append(true_error(model, unit, fit.fitted.unit_map) / error)
        spread = [f"{value:.3f}" for value in (min(forecasts), np.median(forecasts), max(forecasts), max(errors))]
        yield [name, f"{model.source.serial} to {unit.serial}", whole.family, loss, *spread]


def true_error(model: SourceModel, unit: LabelledRecording, unit_map) -> float:
    """Return the RMSE of f behind a map over the whole recording of a unit."""
    return float(np.sqrt(np.mean((model.network.evaluate(unit_map.apply(unit.windows)) - unit.window_reference) ** 2)))


if __name__ == "__main__":
    main()
