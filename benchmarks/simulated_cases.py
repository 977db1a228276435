"""Units of simulated lots with their true errors, shared by the benchmarks of verdict and coverage."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from softcal.core.calibrate import calibrate_unit
from softcal.core.calibration import Calibration
from softcal.core.errors import InputError, UnitRefused
from softcal.core.estimate import Estimate, estimate
from softcal.core.maps.interface import FitProblem
from softcal.core.metrics import rmse
from softcal.core.network import Network
from softcal.core.recording import LabelledRecording
from softcal.core.simulated_lot import FAULTS, SHIFTS, LotDesign, SimulatedUnit, simulate_lot
from softcal.core.source_model import make_source_model
from softcal.core.training import NetworkConfig, fit_network

NETWORK = NetworkConfig(hidden=(40, 20), max_epochs=60, patience=10, batch=128)
"""Smaller than the paper's, for shared network and own calibrations alike, so that hundreds of units fit in minutes."""

TRAIN_SHARE = 0.6
"""Share of the audit recording a unit's own calibration trains on; all errors are on the rest."""


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
    """

    seed: int
    shift: str
    has_stage: bool
    kind: str
    before: float
    after: float
    own: float
    source_rmse: float
    calibration: Calibration | None
    result: Estimate | None
    test: LabelledRecording

    @property
    def is_bad(self) -> bool:
        """After > 1.5 x own, or no map at all."""
        return not self.after <= 1.5 * self.own

    @property
    def score(self) -> float:
        """Forecast error over the source's own: what the unit is ranked by; infinite where refused."""
        if self.calibration is None or self.calibration.predicted_rmse is None:
            return float("inf")
        return self.calibration.predicted_rmse / self.source_rmse


def cases(seeds: range, good: int = 6) -> Iterator[Case]:
    """Yield every unit of the lots of these seeds: all faults once, shifts in turn, with and without stage position."""
    shifts = ("none", *SHIFTS)
    for seed in seeds:
        design = LotDesign(
            good=good,
            bad=dict.fromkeys(FAULTS, 1),
            shift=shifts[seed % len(shifts)],
            has_stage=bool((seed // len(shifts)) % 2 == 0),
        )
        lot = simulate_lot(seed, design)
        trained = fit_network(lot.source, NETWORK)
        model = make_source_model(lot.source, trained.network, trained.validation_rows)
        for unit in lot.units:
            split = int(TRAIN_SHARE * len(unit.audit))
            test = unit.audit.part(split, len(unit.audit))
            calibration = _calibrate(FitProblem(lot.source, trained.network, unit.recording), model)
            result = None if calibration is None else estimate(trained.network, calibration, test.unlabelled)
            yield Case(
                seed,
                design.shift,
                design.has_stage,
                unit.kind,
                before=rmse(trained.network.evaluate(test.windows), test.window_reference),
                after=float("nan") if result is None else rmse(result.estimate, test.reference),
                own=_own_rmse(unit, split, test, trained.network),
                source_rmse=model.held_out_rmse,
                calibration=calibration,
                result=result,
                test=test,
            )


def _calibrate(problem: FitProblem, model) -> Calibration | None:  # type: ignore[no-untyped-def]
    try:
        return calibrate_unit(problem, source_model=model)
    except UnitRefused:
        return None


def _own_rmse(unit: SimulatedUnit, split: int, test: LabelledRecording, shared: Network) -> float:
    try:
        own = fit_network(unit.audit.part(0, split), NETWORK).network
    except InputError:
        return float(np.std(test.window_reference))
    return rmse(own.evaluate(test.windows), test.window_reference)


def coverage(result: Estimate, test: LabelledRecording, trusted_only: bool = False) -> float:
    """Return the share of samples whose force lies in its interval."""
    rows = np.isfinite(result.estimate)
    if trusted_only:
        rows &= result.flag == ""
    inside = (result.lower <= test.reference) & (test.reference <= result.upper)
    return float(inside[rows].mean())


def roc_auc(scores: list[float], labels: list[bool]) -> float:
    """Return the area under the ROC curve: P(score of a bad unit > score of a good one), ties count half."""
    bad = np.array([s for s, label in zip(scores, labels, strict=True) if label])
    good = np.array([s for s, label in zip(scores, labels, strict=True) if not label])
    if not len(bad) or not len(good):
        return float("nan")
    return float(np.mean((bad[:, None] > good) + 0.5 * (bad[:, None] == good)))
