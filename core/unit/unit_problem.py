"""All that the calibration of one unit starts from, and the identity it has by that."""

from dataclasses import asdict, dataclass, field, replace
from functools import cached_property

import numpy as np

from softcal.core.errors import InputError
from softcal.core.identity import content_sha256
from softcal.core.maps.common_load import SPREAD
from softcal.core.maps.interface import Anchors, FitProblem
from softcal.core.messages.reason import Reason, reason
from softcal.core.metrics import rms
from softcal.core.network.config import NetworkConfig
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.unit.budget import Reference
from softcal.core.unit.day_correction import DayCorrection
from softcal.core.unit.line_spread import LineSpread
from softcal.core.unit.lot_fit import LotMap
from softcal.core.unit.measured_error import MeasuredError
from softcal.core.unit.rules import rules_in_force
from softcal.core.unit.source_model import SourceModel
from softcal.core.unit.verdict import Limit, default_limit

LOT_FIT_NUMBERS = ("number", "units", "common_rmse", "unit_rmse")


@dataclass(frozen=True, eq=False)
class UnitProblem:
    """All that the calibration of one unit starts from.

    Args:
        source: what `make_source_model` made of the lot's source with the method in force.
        limit: tolerance limit of the lot; None derives one from the source's own error and says so.
        audit: labelled recording of the unit, which decides and fits nothing; None where there is none.
        own: how the unit's own calibration is trained on its audit, for comparison, or the error of one that was; None
            trains none.
        line: how differently the line presses units, where somebody stated it.
        reference: what the source was compared with; None where nobody said, and nothing is traced to it.
        day_correction: the source unit pressed again in the sitting of this unit, where somebody did.
        other_networks: networks of the lot's other sources, which the unit was compared with (`nearest`).
        rules: identities of the rules of other packages that may hold the unit back; those installed here by default.
        unread_audit: why a file that was brought as its audit cannot be read; "" where none was or it can.
        lot_map: what the fit of its lot gives it; None where it is mapped by itself.
        press_spread: share of the load by which the fit of its lot saw the presses differ; 0 where it saw nothing.
    """

    source: SourceModel
    recording: OutputRecording
    limit: Limit | None = None
    anchors: Anchors | None = None
    audit: LabelledRecording | None = None
    own_calibration: NetworkConfig | MeasuredError | None = None
    line: LineSpread | None = None
    reference: Reference | None = None
    day_correction: DayCorrection | None = None
    other_networks: tuple[str, ...] = ()
    rules: tuple[str, ...] = field(default_factory=rules_in_force)
    unread_audit: str = ""
    lot_map: LotMap | None = None
    press_spread: float = 0.0

    @cached_property
    def fit_id(self) -> str:
        """Content hash of everything that the fit depends on: equal input, equal fit."""
        anchors = self.anchors
        return content_sha256(
            {},
            {
                "recording": self.recording.sha256,
                "network": self.source.network.id,
                "method": self.source.method.id,
                "anchors": None if anchors is None else [anchors.output.tolist(), anchors.reference.tolist()],
                "line": self.line and vars(self.line),
                "golden": self.day_correction and self.day_correction.sha256,
                "reference": self.reference and self.reference.to_json(),
                "other_networks": sorted(self.other_networks),
                "lot_fit": self.lot_map and [self.lot_map.sha256, vars(self.lot_map.part)],
                "press_spread": self.press_spread,
                # Rules look at the limit and at what was measured.
                "rules": [*sorted(self.rules), *self._decided_by] if self.rules else [],
            },
        )

    @cached_property
    def input_sha256(self) -> str:
        """Content hash of everything that the unit's state depends on: equal input, equal state."""
        # Without an audit no own calibration is trained, whatever was asked.
        own_calibration = None if self.audit is None or self.own_calibration is None else asdict(self.own_calibration)
        return content_sha256({}, {"fit": self.fit_id, "decided_by": self._decided_by, "own": own_calibration})

    @property
    def _decided_by(self) -> list[object]:
        limit, audit = self.limit, self.audit
        return [limit and limit.to_json(), audit and audit.sha256, self.unread_audit]

    @cached_property
    def fit(self) -> FitProblem:
        """What the map is fitted to: the golden run where the unit shares its loads in time, else the source."""
        if self._golden_problem is not None and self._golden_problem.synchrony.is_synchronous:
            return self._golden_problem
        return self._problem_of(self.source.source)

    @cached_property
    def _golden_problem(self) -> FitProblem | None:
        return None if self.day_correction is None else self._problem_of(self.day_correction.golden)

    def _problem_of(self, source: LabelledRecording) -> FitProblem:
        return FitProblem(source, self.source.network, self.recording, self.anchors, self.source.method.map)

    @property
    def applied_day_correction(self) -> DayCorrection | None:
        """The day correction that the map is fitted with; None where it is fitted to the source's recording."""
        return (
            self.day_correction
            if self.day_correction is not None and self.fit.source is self.day_correction.golden
            else None
        )

    @cached_property
    def limit_in_force(self) -> Limit:
        """The lot's limit, or the one that follows from the source's own error; with U of the reference.

        Raises:
            InputError: the limit is stated in another unit than the reference.
        """
        unit, config = self.source.source.reference_unit, self.source.method.decision
        limit = self.limit or default_limit(unit, self.source.held_out_rmse, self.source.full_range, config)
        if limit.unit != unit:
            raise InputError(f"limit is in {limit.unit}, the reference in {unit}; state it in that")
        if self.reference is None:
            return limit
        load = rms(self.source.source.reference)
        return replace(limit, reference_expanded=self.reference.expanded(load))

    def reference_variance(self) -> Array:
        """Return the squared standard uncertainty of the reference at each load level; 0 where nobody stated it."""
        loads = self.source.interval.levels
        return np.zeros_like(loads) if self.reference is None else self.reference.variance(loads)

    @property
    def line_share(self) -> float:
        """What somebody stated of the line, and what the fit of its lot saw of the press, as a share of the load."""
        return float(np.hypot(0.0 if self.line is None else self.line.share, self.press_spread))

    def blocking_reasons(self) -> tuple[Reason, ...]:
        """Return what keeps the unit from passing whatever its error is."""
        highest = float(self.source.source.reference.max())
        return () if self.reference is None else self.reference.blocking_reasons(highest)

    @property
    def unreadable_audit(self) -> Reason | None:
        """Why a file that was brought as its audit cannot be read; None where none was or it can."""
        return reason("audit.unreadable", error=self.unread_audit) if self.unread_audit else None

    def line_reasons(self, load_rms: float) -> tuple[Reason, ...]:
        """Say what the line adds that no recording shows, at the RMS load above rest of the unit's recording."""
        config, line = self.source.method.line, self.line
        is_stated = line is not None and line.load is not None, line is not None and line.day is not None
        open_share = float(np.hypot(*np.where(is_stated, 0.0, [config.load_spread, config.day_spread])))
        reasons, unit = list[Reason](), self.source.source.reference_unit
        # A stated spread is in the forecast already; beside it stands the method's default of what nobody stated.
        if line is not None:
            compared, rmse = _compared(*is_stated), line.share * load_rms
            reasons.append(reason("line.stated", between=compared, share=line.share, rmse=rmse, unit=unit))
        if not all(is_stated):
            compared, rmse = _compared(*(not one for one in is_stated)), open_share * load_rms
            reasons.append(reason("line.open", between=compared, share=open_share, rmse=rmse, unit=unit))
        return tuple(reasons)

    def lot_fit_reasons(self) -> tuple[Reason, ...]:
        """Say which fit of the lot the map comes from, or what of the press keeps it alone; else nothing."""
        if self.lot_map is None:
            return (reason(SPREAD, share=self.press_spread),) if self.press_spread else ()
        part, unit = vars(self.lot_map.part), self.source.source.reference_unit
        return (reason("lot_fit.member", unit=unit, **{name: part[name] for name in LOT_FIT_NUMBERS}),)

    def day_correction_reasons(self) -> tuple[Reason, ...]:
        """Say what the golden run is worth to the unit; nothing where there is none."""
        if self.day_correction is None or self._golden_problem is None:
            return ()
        if self.applied_day_correction is None:
            return (reason("bridge.unused", correlation=self._golden_problem.synchrony.rank_correlation),)
        if self.day_correction.golden.serial != self.source.source.serial:
            return (reason("bridge.unit", serial=self.day_correction.golden.serial),)
        if not self.day_correction.is_measured:
            return (reason("bridge.read"),)
        return (
            reason("bridge.measured", day=self.day_correction.day_rmse, unit=self.day_correction.golden.reference_unit),
        )


def _compared(is_load: bool, is_day: bool) -> Reason:
    """Say between what a line differs: units, days, or both."""
    if is_load and is_day:
        return reason("part.units_and_days")
    return reason("part.units") if is_load else reason("part.days")
