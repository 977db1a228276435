"""One unit from its recording to its calibration, for line, batch, workers and Python alike.

The one place that makes a `UnitProblem` of a unit of a registry or of files; `core.transfer` makes those of twins.
It asks no registry and reads no file: see `lot_context.py`.
"""

import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

from softcal.core.errors import InputError, UnitRefused
from softcal.core.maps.anchors import check_loads
from softcal.core.maps.interface import Anchors
from softcal.core.messages.reason import Reason, reason
from softcal.core.network.config import NetworkConfig
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.budget import Reference
from softcal.core.unit.calibrate import calibrate, nearest
from softcal.core.unit.day_correction import DayCorrection
from softcal.core.unit.line_spread import LineSpread
from softcal.core.unit.rules import rules_in_force
from softcal.core.unit.source_model import SourceModel
from softcal.core.unit.state import UnitState
from softcal.core.unit.unit_problem import UnitProblem
from softcal.core.unit.verdict import Limit, Verdict


@dataclass(frozen=True, eq=False)
class UnitInputs:
    """What is known of a unit beside its recording.

    Args:
        anchors: known loads, where someone brought them with the recording.
        stored_loads: known loads by the hash of their recording; asked where `anchors` is None.
        golden: hash of the golden run by the hash of the recording it belongs to.
        audit: its labelled recording, which decides and fits nothing.
        unread_audit: why a file that was brought as its audit cannot be read.
    """

    anchors: Anchors | None = None
    stored_loads: Mapping[str, Anchors] = field(default_factory=dict)
    golden: Mapping[str, str] = field(default_factory=dict)
    audit: LabelledRecording | None = None
    unread_audit: str = ""


@dataclass(frozen=True, eq=False)
class LotContext:
    """What all units of a lot are calibrated with.

    Args:
        sources: each source's recording, its shared network and all that the method in force derives from them; the
            lot's own source first.
        limit: the lot's limit; None derives one from the source's own error.
        own_calibration: how own calibrations are trained on audits, for comparison; None trains none.
        day_correction: the source pressed again in the units' sitting, where a lot folder has that run. Under the load
            cell it outranks what the registry knows; without, it serves units of which the registry knows no golden
            run.
        day_corrections: golden runs of recordings in the registry, by hash; in place of one that f
            cannot read, why.
        rules: identities of the installed rules that may hold units back.
    """

    sources: tuple[SourceModel, ...]
    limit: Limit | None = None
    own_calibration: NetworkConfig | None = None
    line: LineSpread | None = None
    reference: Reference | None = None
    day_correction: DayCorrection | None = None
    day_corrections: Mapping[str, DayCorrection | str] = field(default_factory=dict)
    rules: tuple[str, ...] = field(default_factory=rules_in_force)

    @property
    def source(self) -> SourceModel:
        return self.sources[0]

    def problems(self, recording: OutputRecording, inputs: UnitInputs) -> list[UnitProblem]:
        """Return the unit with each source, in the order of the lot.

        Raises:
            InputError: its known loads or its golden run cannot be used; the reason says why.
        """
        anchors = inputs.stored_loads.get(recording.sha256) if inputs.anchors is None else inputs.anchors
        if anchors is not None:
            try:
                check_loads(self.source.source, anchors, "the unit was not calibrated", self.source.method.map.anchors)
            except InputError as error:
                raise InputError(reason("wrong_loads", error=str(error))) from error
        day_correction = self.day_corrections.get(inputs.golden.get(recording.sha256, ""), self.day_correction)
        if self.day_correction is not None and self.day_correction.is_measured:
            day_correction = self.day_correction
        if isinstance(day_correction, str):
            raise InputError(reason("wrong_golden", error=day_correction))
        audit = inputs.audit
        if (
            audit is not None
            and isinstance(day_correction, DayCorrection)
            and audit.sha256 == day_correction.run_sha256
        ):
            # What gave the loads of a sitting measures none of its maps.
            audit = None
        networks = {model.network.id for model in self.sources}
        return [
            UnitProblem(
                model,
                recording,
                self.limit,
                anchors,
                audit,
                self.own_calibration,
                self.line,
                self.reference,
                # The golden run is one of the lot's own source: it says nothing of the others.
                day_correction if model is self.source else None,
                tuple(networks - {model.network.id}),
                self.rules,
                inputs.unread_audit,
            )
            for model in self.sources
        ]


@dataclass(frozen=True)
class Refusal:
    """A unit that got no map, and why."""

    verdict: Verdict
    reason: Reason


@dataclass(frozen=True)
class ExistingCalibration:
    """A unit whose calibration from this very input is there already."""

    input_sha256: str


@dataclass(frozen=True, eq=False)
class Calibrated:
    """A unit that was calibrated now, and the hash of what asked for it."""

    state: UnitState
    input_sha256: str


Result = Calibrated | Refusal | ExistingCalibration


def calibrate_unit(
    lot: LotContext,
    recording: OutputRecording,
    unit: UnitInputs = UnitInputs(),
    existing: Collection[str] = (),  # noqa: B008
) -> Result:
    """Calibrate a unit with the source that suits it best; inputs among `existing` were
    calibrated already.

    Raises:
        InputError: the lot's limit is stated in another unit than the reference.
    """
    try:
        problems = lot.problems(recording, unit)
    except InputError as error:
        return Refusal(Verdict.RETEST, error.reason)
    for problem in problems:
        # Its input names the sources it was chosen among: the choice need not be made again.
        if problem.input_sha256 in existing:
            return ExistingCalibration(problem.input_sha256)
    return calibrated(problems[0] if len(problems) == 1 else nearest(problems))


def calibrated(problem: UnitProblem) -> Calibrated | Refusal:
    """Calibrate a unit; one that allows no map gets its reason.

    Raises:
        InputError: the lot's limit is stated in another unit than the reference.
    """
    start_s, mapped_s = time.perf_counter(), list[float]()
    try:
        state = calibrate(problem, lambda: mapped_s.append(time.perf_counter()))
    except UnitRefused as error:
        return Refusal(Verdict.FAIL, error.reason)
    # What an audited unit's own network takes to train is no part of what its map took.
    fit = replace(state.fit, fit_s=mapped_s[0] - start_s)
    return Calibrated(replace(state, fit=fit), problem.input_sha256)
