"""What a few lost or bad samples change: forecast, estimates and map of a unit with them, beside those without.

    python benchmarks/lost_samples.py [--seeds N] [--sets eGaIn skin ...]

Measured recordings lose samples: 5 at random places, 5 in a row, 20 at random places. Or 5 samples at random places
hold a bad value, which the look has to find: 0, half of the output, the rail (the highest output and half of its range)
or a logger's 9.9E37. Every recording is looked at before it is fitted, the one without as well. The source stays whole.
"""

import argparse
from collections.abc import Callable, Iterator

import numpy as np
from common.map_methods import DATA, NETWORK, egain, insole, skin, taxel
from common.tables import print_table

from softcal.core.inspection.build import build_recording
from softcal.core.network.training import fit_network
from softcal.core.recording import Array, Indices, LabelledRecording, OutputRecording, Rng
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
        yield "skin", skin("middle").part(0, 2400), [skin(position).part(0, 2400) for position in ("left", "right")]
    if "insole" in sets:
        table = insole("calibration")
        yield "insole, another day", taxel(table, "taxel_001"), [taxel(insole("validation_1"), one) for one in TAXELS]
        yield "insole, in step", taxel(table, "taxel_001"), [taxel(table, one) for one in TAXELS]
    if "nylon" in sets:
        yield "nylon", nylon("sin_20"), [nylon("tri_30"), nylon("mixed_10_20")]


Damage = Callable[[Array, Rng], tuple[Array, Indices]]
"""Changes an output (n,); returns it, NaN where a sample is lost, and which rows it changed."""


def anywhere(count: int, bad: Callable[[Array], Array | float]) -> Damage:
    """Return what puts bad values at so many random places."""

    def damage(output: Array, rng: Rng) -> tuple[Array, Indices]:
        rows = rng.choice(len(output) - 60, count, replace=False) + 30
        damaged = output.copy()
        damaged[rows] = np.broadcast_to(bad(output), output.shape)[rows]
        return damaged, rows

    return damage


def in_a_row(output: Array, rng: Rng) -> tuple[Array, Indices]:
    """Lose five samples in a row."""
    start = int(rng.integers(30, len(output) - 35))
    rows, damaged = np.arange(start, start + 5), output.copy()
    damaged[rows] = np.nan
    return damaged, rows


DAMAGES: dict[str, Damage] = {
    "5 lost": anywhere(5, lambda output: np.nan),
    "5 lost in a row": in_a_row,
    "20 lost": anywhere(20, lambda output: np.nan),
    "5 of 0": anywhere(5, lambda output: 0.0),
    "5 halved": anywhere(5, lambda output: output / 2),
    "5 at the rail": anywhere(5, lambda output: output.max() + np.ptp(output) / 2),
    "5 of 9.9E37": anywhere(5, lambda output: 9.9e37),
}


def looked_at(recording: OutputRecording, output: Array) -> tuple[OutputRecording, Indices]:
    """Return a recording with another output as the look leaves it, and the rows that it takes out."""
    inspected = build_recording(
        recording.serial,
        recording.t_s,
        output,
        sample_rate_Hz=recording.sample_rate_Hz,
        output_unit=recording.output_unit,
        config=Method().inspection,
    )
    return inspected.recording, np.setdiff1d(np.arange(len(output)), inspected.rows)


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
    header = ("set", "unit", "family", "damage", "left out", "good left out", "least", "median", "largest")
    print_table((*header, "true error, largest"), rows)


def ratios(name: str, model: SourceModel, unit: LabelledRecording, seeds: int) -> Iterator[list[object]]:
    """Yield rows of a table: ratios of forecast and of true error with and without a damage, over seeds."""
    raw = unit.unlabelled
    recording, usual = looked_at(raw, raw.output)
    whole, _ = fit_unit(UnitProblem(model, recording))
    error = true_error(model, unit, whole.fitted.unit_map)
    for damage, apply in DAMAGES.items():
        forecasts, errors, found_count, planted, good = [], [], 0, 0, 0
        for seed in range(seeds):
            output, rows = apply(raw.output, np.random.default_rng(seed))
            part, left_out = looked_at(raw, output)
            fit, _ = fit_unit(UnitProblem(model, part))
            forecasts.append(fit.forecast.rmse / whole.forecast.rmse)
            errors.append(true_error(model, unit, fit.fitted.unit_map) / error)
            planted += len(rows)
            found_count += len(np.intersect1d(rows, left_out))
            good += len(np.setdiff1d(left_out, [*rows, *usual]))
        spread = [f"{value:.3f}" for value in (min(forecasts), np.median(forecasts), max(forecasts), max(errors))]
        unit_name = f"{model.source.serial} to {unit.serial}"
        yield [name, unit_name, whole.family, damage, f"{found_count} of {planted}", good, *spread]


def true_error(model: SourceModel, unit: LabelledRecording, unit_map) -> float:
    """Return the RMSE of f behind a map over the whole recording of a unit."""
    return float(np.sqrt(np.mean((model.network.evaluate(unit_map.apply(unit.windows)) - unit.window_reference) ** 2)))


if __name__ == "__main__":
    main()
