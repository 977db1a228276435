"""Units of simulated lots with their true errors, shared by the benchmarks of verdict and coverage."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from common.own_forecast import forecast_own_error, own_terms
from common.planted import FAULTS, planted

from softcal.core.errors import InputError, UnitRefused
from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.network.training import fit_network
from softcal.core.recording import Array, LabelledRecording
from softcal.core.simulated_lot import SHIFTS, LotDesign, SimulatedUnit, simulate_lot
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.estimate import Estimate, estimate
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import SourceModel, make_source_model
from softcal.core.unit.state import UnitState
from softcal.core.unit.unit_problem import UnitProblem

NETWORK = NetworkConfig(hidden=(40, 20), max_epochs=60, patience=10, batch=128)
"""Smaller than the paper's, for shared network and own calibrations alike, so that hundreds of units fit in minutes."""

TRAIN_SHARE = 0.6
"""Share of the audit recording a unit's own calibration trains on; all errors are on the rest."""


SHIFTS_WITHOUT_STAGE = ("none", "none", "none", "short profile", "none", "other dwell")
"""A line that does not know its stage has to press its units as it pressed the source; a few do not."""


@dataclass(frozen=True, eq=False)
class Case:
    """One unit and its truth.

    Args:
        seed, shift, has_stage: of its lot.
        kind: good, or the planted fault.
        before, after, own: RMSE in N on the test part of the audit; `after` is NaN for a refused unit.
        source_rmse: the source's own held-out RMSE, N.
        calibration: None where the unit was refused.
        result, test: estimates over the test part, and its truth.
        network: the shared network of its lot.
        source_half_width: the interval's table for the source itself.
        problem: what its map was fitted to.
    """

    seed: int
    shift: str
    has_stage: bool
    kind: str
    before: float
    after: float
    own: float
    source_rmse: float
    calibration: UnitState | None
    result: Estimate | None
    test: LabelledRecording
    network: Network
    source_half_width: Array
    problem: UnitProblem

    @cached_property
    def own_terms(self) -> dict[str, float]:
        return own_terms(self.problem)

    @property
    def is_bad(self) -> bool:
        """After > 1.5 x own, or no map at all."""
        return not self.after <= 1.5 * self.own

    @property
    def score(self) -> float:
        """Forecast error over that forecast for a calibration of its own: what ranks the units; infinite if refused."""
        if self.calibration is None:
            return float("inf")
        return self.calibration.predicted_rmse / forecast_own_error(
            self.own_terms, self.calibration.fit.correspondence.kind
        )


def lot_design(seed: int, faults: tuple[str, ...] = tuple(FAULTS)) -> LotDesign:
    """Return the design of a lot: each fault once; even seeds know the stage position and see every shift in turn."""
    has_stage = seed % 2 == 0
    shifts = tuple(SHIFTS) if has_stage else SHIFTS_WITHOUT_STAGE
    return LotDesign(good=5, bad=planted(faults), shift=shifts[(seed // 2) % len(shifts)], has_stage=has_stage)


def cases(seeds: range, faults: tuple[str, ...] = tuple(FAULTS), has_own: bool = True) -> Iterator[Case]:
    """Yield every unit of the lots of these seeds, with these faults planted once each.

    Own calibrations take most of the time; without them `Case.own` is NaN and nothing is called bad or good.
    """
    for seed in seeds:
        design = lot_design(seed, faults)
        lot = simulate_lot(seed, design)
        trained = fit_network(lot.source, NETWORK)
        model = make_source_model(lot.source, trained.network, trained.validation_rows, method=Method())
        for unit in lot.units:
            split = int(TRAIN_SHARE * len(unit.audit))
            test = unit.audit.part(split, len(unit.audit))
            own = _own_rmse(unit.audit.part(0, split), test) if has_own else float("nan")
            yield calibrate_case(seed, design, unit, own, trained.network, model)


def calibrate_case(
    seed: int, design: LotDesign, unit: SimulatedUnit, own: float, network: Network, model: SourceModel
) -> Case:
    """Calibrate one unit and set the truth beside it."""
    test = unit.audit.part(int(TRAIN_SHARE * len(unit.audit)), len(unit.audit))
    problem = UnitProblem(model, unit.recording)
    calibration = _calibrate(problem)
    result = None if calibration is None else estimate(network, calibration, test.unlabelled)
    return Case(
        seed,
        design.shift,
        design.has_stage,
        unit.kind,
        before=rmse(network.evaluate(test.windows), test.window_reference),
        after=float("nan") if result is None else rmse(result.estimate, test.reference),
        own=own,
        source_rmse=model.held_out_rmse,
        calibration=calibration,
        result=result,
        test=test,
        network=network,
        source_half_width=model.interval.half_width,
        problem=problem,
    )


def _calibrate(problem: UnitProblem) -> UnitState | None:
    try:
        return calibrate(problem)
    except UnitRefused:
        return None


def _own_rmse(train: LabelledRecording, test: LabelledRecording) -> float:
    try:
        own_network = fit_network(train, NETWORK).network
    except InputError:
        # A dead or clipped unit teaches nothing: its own calibration is the mean load.
        return float(np.std(test.window_reference))
    return rmse(own_network.evaluate(test.windows), test.window_reference)


def coverage(result: Estimate, test: LabelledRecording, trusted_only: bool = False) -> float:
    """Return the share of samples whose force lies in its interval."""
    rows = np.isfinite(result.estimate)
    if trusted_only:
        rows &= result.flag == ""
    inside = (result.lower <= test.reference) & (test.reference <= result.upper)
    return float(inside[rows].mean())


def roc_auc(scores: list[float], labels: list[bool]) -> float:
    """Return the area under the ROC curve: P(score of a bad unit > score of a good one), ties count half."""
    bad, good = (np.array(scores)[np.equal(labels, is_bad)] for is_bad in (True, False))
    return float(np.mean((bad[:, None] > good) + 0.5 * (bad[:, None] == good))) if len(bad) and len(good) else np.nan
