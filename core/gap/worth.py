"""What a cause explains of the calibration error: f trained on twins and on the rig."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from softcal.core.errors import InputError
from softcal.core.gap.case import Case, Run
from softcal.core.gap.explained import explained_twin
from softcal.core.gap.fit import Fit, fit
from softcal.core.gap.method import METHOD
from softcal.core.gap.start import base_fit
from softcal.core.gap.transfer import NETWORK, pressed
from softcal.core.metrics import rmse
from softcal.core.network.training import fit_network
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.twin.simulate import Twin


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
    fitted_on: int = METHOD.worth.fitted_on

    @property
    def worth(self) -> int | None:
        """Fewest rig recordings whose f is not worse than the explained twin's; None where all are too few."""
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
    return next((k for k, own in enumerate(rig, start=1) if own <= METHOD.worth.alike * error), None)


def calibration_worth(
    unit: str, case: Case, audit: Case, shared: Fit, say: Callable[[str], None] = lambda _: None
) -> CalibrationWorth:
    """Train f on the unit's nominal and explained twin and on its rig recordings, and test all on its audit.

    Base parameters and sizes are fitted to the first recording alone. The twins are then pressed along the stage
    positions of all recordings.

    Args:
        shared: a fit of the lot's causes to this unit: it gives the equations; its sizes are only where a fit begins.

    Raises:
        InputError: a run lacks stage position, force or output.
    """
    runs = [_checked(unit, run) for run in case.presses]
    say(f"{unit}: training f on twins and on 1 to {len(runs)} rig recordings")
    test = _joined(unit, [_labelled(unit, _checked(unit, run)) for run in audit.presses])
    bare = base_fit(Case(case.serial, tuple(runs[: METHOD.worth.fitted_on])))
    # Episodes belong to the recordings they were found in.
    hypothesis = shared.hypothesis.without_episodes()
    start = np.append(bare.coordinates, shared.coordinates[hypothesis.of_base.stop :])
    full = fit(bare.problem, hypothesis, start, steps=40)
    recorded = [_labelled(unit, run) for run in runs]
    return CalibrationWorth(
        unit,
        _error(_simulated(unit, explained_twin(bare), runs), test),
        _error(_simulated(unit, explained_twin(full), runs), test),
        tuple(_error(_joined(unit, recorded[:k]), test) for k in range(1, len(recorded) + 1)),
    )


def _checked(unit: str, run: Run) -> Run:
    for channel in ("stage_mm", "force_N", "output_V"):
        if getattr(run, channel) is None:
            raise InputError(
                f"{unit}, {run.name}: {channel} is missing; f is trained on force and output, twins on both"
            )
    return run


def _labelled(unit: str, run: Run) -> LabelledRecording:
    if run.output_V is None or run.force_N is None:
        raise ValueError(f"{run.name} has no force or no output")
    output = OutputRecording(unit, run.t_s, run.output_V, run.readout.sample_rate_Hz, stage_mm=run.stage_mm)
    return LabelledRecording(output, run.force_N)


def _simulated(unit: str, twin: Twin, runs: Sequence[Run]) -> LabelledRecording:
    rng = np.random.default_rng(0)
    return _joined(unit, [pressed(twin, _labelled(unit, run).unlabelled, rng, run.temperature_C) for run in runs])


def _joined(unit: str, parts: Sequence[LabelledRecording]) -> LabelledRecording:
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
