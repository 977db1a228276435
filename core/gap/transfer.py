"""How well calibrations of simulated lots foretell those on the rig, without and with causes."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from softcal.core.errors import InputError, UnitRefused
from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.network.training import fit_network
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.simulated_lot import LotDesign, draw_lot
from softcal.core.twin.simulate import Twin, simulate
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.estimate import estimate
from softcal.core.unit.source_model import make_source_model
from softcal.core.unit.unit_problem import UnitProblem

NETWORK = NetworkConfig(hidden=(40, 20), max_epochs=60, patience=10, batch=128)
"""Smaller than the paper's and the same for rig and twins, which alone are compared."""

TRAIN_SHARE = 0.6
"""Share of an audit that a unit's own calibration trains on; all errors are on the rest."""


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
    """Calibration results of a lot, medians over its units, in N.

    Args:
        before: the shared network without any map.
        after: with the unit's map.
        own: a network trained on the unit's own labels.
    """

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
        places = {k: asdict(getattr(self, k)) | {"after_by_own": getattr(self, k).after_by_own} for k in _PLACES}
        return {"schema": "softcal.transfer/1", "units": self.units, **places, "relative_error": errors}


_PLACES = ("rig", "base", "explained")


def transfer(
    rig: PressedLot, base: Twin, explained: Twin, seed: int = 0, say: Callable[[str], None] = lambda _: None
) -> Transfer:
    """Calibrate the rig's lot and one simulated lot per twin, pressed along the same stage positions.

    Args:
        seed: of the spread and the noise of the simulated units; both twins get the same.
    """
    say("calibrating the rig's lot")
    on_rig = lot_errors(rig)
    say("calibrating a lot of the base twin")
    by_base = lot_errors(simulated_like(rig, base, seed))
    say("calibrating a lot of the explained twin")
    return Transfer(on_rig, by_base, lot_errors(simulated_like(rig, explained, seed)), units=len(rig.units))


def simulated_like(rig: PressedLot, twin: Twin, seed: int) -> PressedLot:
    """Return a simulated lot around a twin, pressed along the stage positions of the rig's."""
    rng = np.random.default_rng(seed)
    twins = draw_lot(rng, len(rig.units) + 1, twin, LotDesign().spread)
    units = tuple(
        LotUnit(pressed(own, u.recording, rng).unlabelled, pressed(own, u.audit.unlabelled, rng))
        for own, u in zip(twins[1:], rig.units, strict=True)
    )
    return PressedLot(pressed(twins[0], rig.source.unlabelled, rng), units)


def pressed(
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
    model = make_source_model(lot.source, trained.network, trained.validation_rows)
    rows: list[Sequence[float]] = []
    for unit in lot.units:
        split = int(TRAIN_SHARE * len(unit.audit))
        test = unit.audit.part(split, len(unit.audit))
        own = fit_network(unit.audit.part(0, split), NETWORK).network
        before = rmse(trained.network.evaluate(test.windows), test.window_reference)
        after = before
        try:
            calibration = calibrate(UnitProblem(model, unit.recording))
            after = rmse(estimate(trained.network, calibration, test.unlabelled).estimate, test.reference)
        except UnitRefused:
            # A unit without a map goes on as it is.
            pass
        rows.append((before, after, rmse(own.evaluate(test.windows), test.window_reference)))
    return LotErrors(*(float(np.median(column)) for column in zip(*rows, strict=True)))
