"""The golden unit pressed in the units' sitting as a bridge: taxels of the insole fitted on another day's programme.

Each source is the golden unit of the others: its own run of that day is fitted to, once as its output alone, once with
the pressure beside it. After / own as in maps_insole.py: own networks were trained on the other day as well, and all
are tested on held-out stretches of the source's day.
"""

from collections.abc import Mapping, Sequence
from functools import cache, partial
from pathlib import Path

import numpy as np
from common.command import ResultCache
from common.map_methods import METHODS, insole, own_error, split, taxel, taxels
from common.simulated_cases import NETWORK
from common.tables import print_table

from softcal.core.maps.interface import FitProblem
from softcal.core.metrics import rmse
from softcal.core.network.training import fit_network
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.day_correction import DayCorrection, fit_day_correction
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import SourceModel, make_source_model
from softcal.core.unit.unit_problem import UnitProblem

EVERY = 5
"""Every fifth taxel is a unit."""
EMD = "ot.da.EMDTransport"
WAYS = ("no golden run", "golden run, output alone", "golden run under the load cell", EMD)
PRINTED_WAYS, FORECAST = (WAYS[0], WAYS[2]), "true / forecast, "


def print_golden(sources: Sequence[str], cache: Path) -> None:
    """Print what a golden run brings; what is done is kept in a file of the cache."""
    cache_file = ResultCache(cache / "golden.jsonl")
    ratios = {source: cache_file.get(source, partial(fit_source, source)) for source in sources}
    units = [unit for of_one in ratios.values() for unit in of_one]
    rows = []
    for way in WAYS:
        medians = [float(np.median([unit[way] for unit in of_one])) for of_one in ratios.values()]
        rows.append(
            (way, *np.quantile([unit[way] for unit in units], (0.5, 0.95)).tolist(), min(medians), max(medians))
        )
    print(f"{len(ratios)} sources, {len(units)} units fitted on the other day and programme, after / own:\n")
    print_table("fitted to | median | 95 % | best source | worst source", rows)
    printed_rows = (
        (way, *np.quantile([unit[FORECAST + way] for unit in units], (0.1, 0.5, 0.9)).tolist()) for way in PRINTED_WAYS
    )
    print_table("true / forecast | 10 % | median | 90 %", printed_rows)


def fit_source(source: str) -> list[dict[str, float]]:
    day, golden = insole("calibration"), taxel(insole("validation_1"), source)
    recording = taxel(day, source, split(len(day))[0])
    trained = fit_network(recording, NETWORK)
    model = make_source_model(recording, trained.network, trained.validation_rows, method=Method())
    corrections = {
        WAYS[0]: None,
        WAYS[1]: fit_day_correction(model, golden.unlabelled),
        WAYS[2]: fit_day_correction(model, golden),
    }
    return [fit_unit(model, corrections, name) for name in taxels(day)[2::EVERY] if name != source]


def fit_unit(model: SourceModel, corrections: Mapping[str, DayCorrection | None], name: str) -> dict[str, float]:
    day = insole("calibration")
    unit, test = taxel(insole("validation_1"), name).unlabelled, taxel(day, name, split(len(day))[1])
    own_recording, ratios = own_recording_of(name), dict[str, float]()
    for way, correction in corrections.items():
        calibration = calibrate(UnitProblem(model, unit, day_correction=correction))
        truth = rmse(model.network.evaluate(calibration.unit_map.apply(test.windows)), test.window_reference)
        ratios |= {way: truth / own_recording, FORECAST + way: truth / (calibration.predicted_rmse or np.nan)}
    problem = FitProblem(model.source, model.network, unit)
    return ratios | {EMD: rmse(METHODS[EMD](problem, test), test.window_reference) / own_recording}


@cache
def own_recording_of(name: str) -> float:
    """Error of the unit's own network, trained on the other day."""
    day = insole("calibration")
    return own_error(taxel(insole("validation_1"), name), taxel(day, name, split(len(day))[1]), NETWORK)
