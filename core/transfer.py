"""What a cause explains of the calibration error: on the rig, and on twins without and with it."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from softcal.core.errors import InputError, UnitRefused
from softcal.core.gap.case import Case, Run
from softcal.core.gap.diagnosis import CalibrationGap, Diagnosis
from softcal.core.gap.fault_location import explained_twin
from softcal.core.gap.fit import fit
from softcal.core.gap.model import Fit
from softcal.core.gap.twin import TWIN, TwinModel
from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.network.training import fit_network
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.simulated_lot import LotDesign, draw_lot
from softcal.core.twin.simulate import Twin, simulate
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.estimate import estimate
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import make_source_model
from softcal.core.unit.unit_problem import UnitProblem

NETWORK = NetworkConfig(hidden=(40, 20), max_epochs=60, patience=10, batch=128)
"""Smaller than the paper's and the same for rig and twins, which alone are compared."""


@dataclass(frozen=True, eq=False)
class LotUnit:
    """What the line recorded of a unit, and a labelled recording of it for the truth."""

    recording: OutputRecording
    audit: LabelledRecording


@dataclass(frozen=True, eq=False)
class PressedLot:
    """A source unit and the units made with it; every recording carries its stage position."""

    source: LabelledRecording
    units: tuple[LotUnit, ...]

    def __post_init__(self) -> None:
        recordings = [self.source.unlabelled, *(r for u in self.units for r in (u.recording, u.audit.unlabelled))]
        for recording in recordings:
            if recording.stage_mm is None:
                raise InputError(f"{recording.serial}: no stage_mm; the twin can only follow a recorded stage position")
        if not self.units:
            raise InputError("the lot has no unit with an audit; the truth of at least one is needed")


@dataclass(frozen=True)
class LotErrors:
    """Errors of a lot, medians in N: without a map, with the unit's, with a network of its own."""

    before: float
    after: float
    own: float

    @property
    def after_by_own(self) -> float:
        """Ratio of the paper: 1 where the map does as well as labels would."""
        return self.after / self.own


@dataclass(frozen=True)
class Transfer:
    """Results on the rig beside those that the base twin and the explained twin foretell."""

    rig: LotErrors
    base: LotErrors
    explained: LotErrors
    units: int

    def rows(self) -> list[tuple[str, float, float, float, float, float]]:
        """Return per measure: rig, base twin, explained twin, and the relative errors of both."""
        out = []
        for name in ("before", "after", "own", "after_by_own"):
            rig, base, explained = (float(getattr(e, name)) for e in (self.rig, self.base, self.explained))
            out.append((name, rig, base, explained, abs(base / rig - 1), abs(explained / rig - 1)))
        return out

    def to_record(self) -> dict[str, object]:
        """Return JSON values, schema `softcal.transfer/1`."""
        errors = {name: {"base": b, "explained": e} for name, _, _, _, b, e in self.rows()}
        errors_of_twins = {
            k: asdict(getattr(self, k)) | {"after_by_own": getattr(self, k).after_by_own} for k in _TWINS
        }
        return {"schema": "softcal.transfer/1", "units": self.units, **errors_of_twins, "relative_error": errors}


_TWINS = ("rig", "base", "explained")


def transfer(
    rig: PressedLot, base: Twin, explained: Twin, seed: int = 0, report: Callable[[str], None] = lambda _: None
) -> Transfer:
    """Calibrate the rig's lot and a simulated one per twin, of one seed, along the same positions."""
    report("calibrating the rig's lot")
    on_rig = lot_errors(rig)
    report("calibrating a lot of the base twin")
    by_base = lot_errors(simulate_alike(rig, base, seed))
    report("calibrating a lot of the explained twin")
    return Transfer(on_rig, by_base, lot_errors(simulate_alike(rig, explained, seed)), units=len(rig.units))


def simulate_alike(rig: PressedLot, twin: Twin, seed: int) -> PressedLot:
    """Return a simulated lot around a twin, pressed along the stage positions of the rig's."""
    rng = np.random.default_rng(seed)
    twins = draw_lot(rng, len(rig.units) + 1, twin, LotDesign().spread)
    units = tuple(
        LotUnit(press_twin(unit_twin, u.recording, rng).unlabelled, press_twin(unit_twin, u.audit.unlabelled, rng))
        for unit_twin, u in zip(twins[1:], rig.units, strict=True)
    )
    return PressedLot(press_twin(twins[0], rig.source.unlabelled, rng), units)


def press_twin(
    twin: Twin, like: OutputRecording, rng: np.random.Generator, temperature_C: Array | None = None
) -> LabelledRecording:
    """Return what a twin records when it is pressed along the stage positions of a recording."""
    if like.stage_mm is None:
        raise ValueError(f"{like.serial} has no stage position")
    force_N, output_V = simulate(twin, like.t_s, like.stage_mm, rng, temperature_C)
    return LabelledRecording(
        OutputRecording(like.serial, like.t_s, output_V, like.sample_rate_Hz, stage_mm=like.stage_mm), force_N
    )


def lot_errors(lot: PressedLot) -> LotErrors:
    """Train the shared network on the source, map every unit, return the medians of errors."""
    trained = fit_network(lot.source, NETWORK)
    model = make_source_model(lot.source, trained.network, trained.validation_rows, method=Method())
    rows: list[Sequence[float]] = []
    for unit in lot.units:
        split = int(TWIN.method.worth.train_share * len(unit.audit))
        test = unit.audit.part(split, len(unit.audit))
        own_network = fit_network(unit.audit.part(0, split), NETWORK).network
        before = rmse(trained.network.evaluate(test.windows), test.window_reference)
        after = before
        try:
            calibration = calibrate(UnitProblem(model, unit.recording))
            after = rmse(estimate(trained.network, calibration, test.unlabelled).estimate, test.reference)
        except UnitRefused:
            # A unit without a map goes on as it is.
            pass
        rows.append((before, after, rmse(own_network.evaluate(test.windows), test.window_reference)))
    return LotErrors(*(float(np.median(column)) for column in zip(*rows, strict=True)))


@dataclass(frozen=True)
class CalibrationWorth:
    """Errors of f on a unit's audit, RMS in N.

    Args:
        nominal: trained on the twin without the causes.
        explained: trained on the twin with them.
        rig: trained on the first 1, 2, 3, … recordings of the rig.
        fitted_on: recordings of the rig that both twins were fitted to.
    """

    unit: str
    nominal: float
    explained: float
    rig: tuple[float, ...]
    fitted_on: int = TWIN.method.worth.fitted_on

    @property
    def worth(self) -> int | None:
        """Fewest rig recordings whose f is not worse than the explained twin's; None if too few."""
        return _fewest(self.rig, self.explained)

    @property
    def saves(self) -> int:
        """Rig recordings saved, at least; those that the twin was fitted to are off."""
        return max((self.worth or len(self.rig)) - self.fitted_on, 0)

    @property
    def nominal_saves(self) -> int:
        """The same for the twin without the causes."""
        return max((_fewest(self.rig, self.nominal) or len(self.rig)) - self.fitted_on, 0)

    def record(self) -> dict[str, object]:
        return asdict(self) | {"worth": self.worth, "saves": self.saves, "nominal_saves": self.nominal_saves}


def _fewest(rig: Sequence[float], error: float) -> int | None:
    return next((k for k, rig_error in enumerate(rig, start=1) if rig_error <= TWIN.method.worth.alike * error), None)


def calibration_worth(
    unit: str, case: Case, audit: Case, shared: Fit, report: Callable[[str], None] = lambda _: None
) -> CalibrationWorth:
    """Train f on a unit's nominal and explained twin and on rig recordings, and test all on its audit.

    Base parameters and sizes are fitted to the first recording alone. The twins are pressed along the
    stage positions of all recordings.

    Args:
        shared: a fit of the lot's causes to this unit: its sizes are only where a fit begins.

    Raises:
        InputError: a run lacks stage position, force or output.
    """
    recorded = [_labelled(unit, run) for run in case.presses]
    report(f"{unit}: training f on twins and on 1 to {len(recorded)} rig recordings")
    test = _join_recordings(unit, [_labelled(unit, run) for run in audit.presses])
    bare = TWIN.base_fit(Case(case.serial, case.presses[: TWIN.method.worth.fitted_on]))
    # Episodes belong to the recordings they were found in.
    hypothesis = shared.hypothesis.without_episodes()
    start = np.append(bare.coordinates, shared.coordinates[hypothesis.of_base.stop :])
    full = fit(bare.problem, hypothesis, start, steps=40)

    nominal, explained = (_error_of_twin(explained_twin(one), recorded, case.presses, test) for one in (bare, full))
    of_rig = tuple(_error(_join_recordings(unit, recorded[:k]), test) for k in range(1, len(recorded) + 1))
    return CalibrationWorth(unit, nominal, explained, of_rig)


def calibration_gap(diagnosis: Diagnosis[TwinModel], report: Callable[[str], None] = lambda _: None) -> CalibrationGap:
    """Train f on the base twin, on the repaired twin and on the rig, and test all on the last pressed run.

    Twins and f know the other runs alone: base parameters and sizes are fitted to them once more.

    Raises:
        InputError: fewer than two runs are pressed, or one lacks stage position, force or output.
    """
    case = diagnosis.case
    *training_runs, last = case.presses
    if not training_runs:
        raise InputError(f"case {case.serial}: one run is pressed; a calibration is tested on another one")
    recorded, test = [_labelled(case.serial, run) for run in training_runs], _labelled(case.serial, last)
    report(f"training f on two twins and on the rig, to test it on {last.name}")
    others = replace(case, runs=tuple(run for run in case.runs if run is not last))

    def error_of(twin_fit: Fit) -> float:
        problem = replace(twin_fit.problem, case=others, weight_of_sample=None, extra_variance=None)
        # Episodes belong to the recordings they were found in.
        refitted = fit(problem, twin_fit.hypothesis.without_episodes(), twin_fit.coordinates, steps=40)
        return _error_of_twin(explained_twin(refitted), recorded, training_runs, test)

    of_rig = _error(_join_recordings(case.serial, recorded), test)
    return CalibrationGap(last.name, error_of(diagnosis.base), error_of(diagnosis.best), of_rig)


def _error_of_twin(
    twin: Twin, recorded: Sequence[LabelledRecording], runs: Sequence[Run], test: LabelledRecording
) -> float:
    """Return the error of f that is trained on a twin, pressed along the stage positions of recordings."""
    rng, pairs = np.random.default_rng(0), zip(recorded, runs, strict=True)
    simulated = [press_twin(twin, one.unlabelled, rng, run.temperature_C) for one, run in pairs]
    return _error(_join_recordings(recorded[0].unlabelled.serial, simulated), test)


def _labelled(unit: str, run: Run) -> LabelledRecording:
    for channel in ("stage_mm", "force_N", "output_V"):
        if getattr(run, channel) is None:
            raise InputError(
                f"{unit}, {run.name}: {channel} is missing; f is trained on force and output, twins on both"
            )
    output_V, force_N = np.asarray(run.output_V), np.asarray(run.force_N)
    output = OutputRecording(unit, run.t_s, output_V, run.readout.sample_rate_Hz, stage_mm=run.stage_mm)
    return LabelledRecording(output, force_N)


def _join_recordings(unit: str, parts: Sequence[LabelledRecording]) -> LabelledRecording:
    """Return recordings one after the other, a second apart: no window spans two."""
    times, end_s = [], 0.0
    for part in parts:
        t_s = part.unlabelled.t_s
        times.append(t_s - t_s[0] + end_s)
        end_s = float(times[-1][-1]) + 1.0
    output = np.concatenate([part.unlabelled.output for part in parts])
    joined = OutputRecording(unit, np.concatenate(times), output, parts[0].unlabelled.sample_rate_Hz)
    return LabelledRecording(joined, np.concatenate([part.reference for part in parts]))


def _error(source: LabelledRecording, test: LabelledRecording) -> float:
    return rmse(fit_network(source, NETWORK).network.evaluate(test.windows), test.window_reference)
