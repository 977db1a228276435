"""The result of calibrating one unit: what the registry keeps, what estimates and exports start from."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from softcal.core.identity import Settings
from softcal.core.maps.interface import UnitMap, map_sha256
from softcal.core.metrics import finite_or_none
from softcal.core.recording import Arrays
from softcal.core.unit.audit_reading import AuditReading, OutputLevel
from softcal.core.unit.budget import Reference
from softcal.core.unit.health import OutputLimits
from softcal.core.unit.judging import Grounds
from softcal.core.unit.knowledge import LoadKnowledge, known_by
from softcal.core.unit.measured_error import Scores
from softcal.core.unit.method import Method
from softcal.core.unit.missing import missing_evidence
from softcal.core.unit.uncertainty import ErrorForecast, Interval
from softcal.core.unit.verdict import VERDICTS, Decision, Judgement, Verdict
from softcal.core.words.reason import Reason

Read = TypeVar("Read")

AUDIT_GAIN, AUDIT_ZERO = "audit_gain", "audit_zero"
"""Names under which a calibration keeps, among its numbers, how its fitted map reads the loads of its audit."""

OUTPUT_REST, OUTPUT_SPAN = "output_rest", "output_span"
"""The same of where the output of its recording stands."""

COMMON_GAIN, COMMON_ZERO = "common_gain", "common_zero"
"""The same of what was taken off the map, as the lot's audited units misread it alike."""


@dataclass(frozen=True, eq=False)
class CalibrationRecord:
    """One calibration of one unit as plain values: arrays, JSON settings and numbers. The registry stores it whole.

    Args:
        network_id: content hash of the shared network f it belongs to.
        family: family of the map γ (`maps.catalogue`).
        arrays: parameters of the map (names `map.*`), of the interval and support model (names `interval.*`).
        settings: JSON values beside the arrays, grouped: `map`, `interval`, `forecast`; `decision`, what was predicted
            and what was measured; `grounds`, what that rests on but the limit. `method` has every number of the method,
            `reference` what it is traced to, `audit` what its audit says beside the error.
        predicted_rmse: forecast of the error against the reference, in the reference unit; None where none can be made.
        before_rmse, after_rmse, own_rmse: scores on an audit recording, in the reference unit; None without an audit.
        reasons: why, most important first.
        evidence: numbers the verdict rests on.
        input_sha256: content hash of everything that went in (recording, network, method ...): equal input, equal
            result, so that finished work is found again.
    """

    serial: str
    network_id: str
    family: str
    map_sha256: str
    arrays: Arrays
    settings: Settings
    predicted_rmse: float | None
    verdict: str
    reasons: tuple[Reason, ...]
    input_sha256: str
    recording_sha256: str
    before_rmse: float | None = None
    after_rmse: float | None = None
    own_rmse: float | None = None
    fit_s: float | None = None
    evidence: Mapping[str, float | str | None] = field(default_factory=dict)

    @property
    def forecast_rmse(self) -> float | None:
        """Forecast before audits of other units scaled it; `predicted_rmse` is the one in force."""
        before = self._number("forecast_rmse")
        return self.predicted_rmse if before is None else before

    @property
    def method_id(self) -> str:
        """Content hash of the method it was made with; empty in records of versions that kept none."""
        return str(self.settings.get("method_id", ""))

    @property
    def method(self) -> Method | None:
        """Every number it was made with; None in records of versions that kept none."""
        return self._kept("method", Method.of)

    @property
    def knowledge(self) -> LoadKnowledge:
        """How the loads were known, by the terms of the error budget: each kind has one of its own."""
        budget = {name.removeprefix("u_"): 1.0 for name in self.evidence if name.startswith("u_")}
        kinds = (self.method or Method()).knowledge
        return known_by(budget, kinds, "map_anchor_gain" in self.evidence)

    @property
    def reference(self) -> Reference | None:
        """What the source was compared with; None where nobody said."""
        return self._kept("reference", Reference.of)

    @property
    def decision(self) -> Decision:
        """What was predicted and what was measured. Records of older versions kept the word alone."""
        known = self._kept("decision", Decision.of)
        return known or Decision(Judgement(Verdict(self.verdict), self.reasons))

    @property
    def grounds(self) -> Grounds | None:
        """What it was decided on, but the limit; None in records of older versions."""
        return self._kept("grounds", Grounds.of)

    @property
    def scores(self) -> Scores | None:
        """What its audit showed, each error with its rows; None where none decides."""
        grounds = self.grounds
        return None if grounds is None or self.after_rmse is None else grounds.measured

    @property
    def is_open(self) -> bool:
        """Whether nothing that was found stands against it: its forecast alone may, and audits can correct that."""
        grounds = self.grounds
        return self.decision.predicted.verdict.is_open if grounds is None else grounds.is_open

    @property
    def limit_rmse(self) -> float | None:
        """Limit it was judged against, in the reference unit; None in records of older versions."""
        return self._number("limit_rmse")

    @property
    def audit_line(self) -> tuple[float, float] | None:
        """Gain and zero with which its fitted map reads the loads of its audit; None without one or in old records."""
        return self._pair(AUDIT_GAIN, AUDIT_ZERO)

    @property
    def output_level(self) -> OutputLevel | None:
        """Where the output of its recording stands; None in records of older versions."""
        level = self._pair(OUTPUT_REST, OUTPUT_SPAN)
        return None if level is None else OutputLevel(*level)

    @property
    def common_line(self) -> tuple[float, float] | None:
        """Gain and zero that were taken off its map; None where none were."""
        return self._pair(COMMON_GAIN, COMMON_ZERO)

    @property
    def missing(self) -> Mapping[str, float]:
        """Samples of its recording that were left out, by kind (`masked_*`), and the shares of samples that are missing
        and of windows that are left; empty where nothing is missing.
        """
        return missing_evidence(self.evidence)

    @property
    def load_rms(self) -> float | None:
        """RMS load above rest that its recording shows, in the reference unit; None in records of older versions."""
        return self._number("load_rms")

    @property
    def audit(self) -> AuditReading | None:
        """What its audit says beside the error; None without one, and in records of older versions."""
        return self._kept("audit", AuditReading.of)

    def _kept(self, name: str, read: Callable[[Any], Read]) -> Read | None:
        """Return what was written under a name of the settings; None where nothing was."""
        written = self.settings.get(name)
        return None if written is None else read(written)

    def _number(self, name: str) -> float | None:
        value = self.evidence.get(name)
        return None if value is None else float(value)

    def _pair(self, first: str, second: str) -> tuple[float, float] | None:
        one, other = self._number(first), self._number(second)
        return None if one is None or other is None else (one, other)

    def __post_init__(self) -> None:
        if self.verdict not in VERDICTS:
            raise ValueError(f"verdict {self.verdict!r} is none of {', '.join(VERDICTS)}")


@dataclass(frozen=True, eq=False)
class Calibration:
    """The calibration of one unit, ready to estimate with.

    Args:
        forecast: error forecast without labels, in the reference unit; None where none can be made.
        grounds: what it was decided on, but the limit; None in records of older versions.
        evidence: numbers and words behind it.
        audit: what the audit says beside them; None without one, and in records of older versions.
    """

    serial: str
    network_id: str
    unit_map: UnitMap
    interval: Interval
    output_limits: OutputLimits
    forecast: ErrorForecast | None
    decision: Decision
    knowledge: LoadKnowledge
    evidence: Mapping[str, float | str | None]
    method: Method | None = None
    reference: Reference | None = None
    audit: AuditReading | None = None
    grounds: Grounds | None = None

    @property
    def scores(self) -> Scores | None:
        """What its audit showed; None where none decides."""
        return None if self.grounds is None else self.grounds.measured

    @property
    def predicted_rmse(self) -> float | None:
        """Forecast of the error against a reference, in the reference unit."""
        return None if self.forecast is None else self.forecast.rmse

    def to_record(self, input_sha256: str, recording_sha256: str, fit_s: float | None = None) -> CalibrationRecord:
        """Return the calibration as plain values, with the identities that the caller knows and the time it took."""
        scores = self.scores
        arrays = {f"map.{name}": array for name, array in self.unit_map.arrays().items()}
        arrays |= {f"interval.{name}": array for name, array in self.interval.arrays().items()}
        limits = {name: finite_or_none(value) for name, value in vars(self.output_limits).items()}
        settings = {
            "map": dict(self.unit_map.settings()),
            "interval": {**self.interval.settings(), "output_limits": limits},
            "forecast": None if self.forecast is None else vars(self.forecast),
            "decision": self.decision.to_json(),
            "grounds": None if self.grounds is None else self.grounds.to_json(),
            "method": None if self.method is None else dict(self.method.to_json()),
            "method_id": "" if self.method is None else self.method.id,
            "reference": None if self.reference is None else self.reference.to_json(),
            "audit": None if self.audit is None else self.audit.to_json(),
        }
        return CalibrationRecord(
            serial=self.serial,
            network_id=self.network_id,
            family=self.unit_map.family,
            map_sha256=map_sha256(self.unit_map),
            arrays=arrays,
            settings=settings,
            predicted_rmse=self.predicted_rmse,
            verdict=str(self.decision.verdict),
            reasons=self.decision.reasons,
            input_sha256=input_sha256,
            recording_sha256=recording_sha256,
            before_rmse=None if scores is None else scores.before.rmse,
            after_rmse=None if scores is None else scores.after.rmse,
            own_rmse=None if scores is None or scores.own is None else scores.own.own.rmse,
            fit_s=fit_s,
            evidence=self.evidence,
        )

    @classmethod
    def from_record(cls, record: CalibrationRecord) -> "Calibration":
        """Rebuild a calibration from what the registry keeps; equal to the one that was stored.

        Raises:
            InputError: the map's family is unknown to this version.
        """
        # The families bring solvers that take seconds to import; a registry that lists records needs none of them.
        from softcal.core.maps.catalogue import map_from_arrays

        settings: Mapping[str, Any] = record.settings
        limits = settings["interval"]["output_limits"]
        return cls(
            serial=record.serial,
            network_id=record.network_id,
            unit_map=map_from_arrays(record.family, _group(record.arrays, "map."), settings["map"]),
            interval=Interval.from_arrays(_group(record.arrays, "interval."), settings["interval"]),
            output_limits=OutputLimits(
                rail_low=-np.inf if limits["rail_low"] is None else float(limits["rail_low"]),
                rail_high=np.inf if limits["rail_high"] is None else float(limits["rail_high"]),
                stuck_samples=int(limits["stuck_samples"]),
            ),
            forecast=None if settings["forecast"] is None else ErrorForecast(**settings["forecast"]),
            decision=record.decision,
            knowledge=record.knowledge,
            evidence=record.evidence,
            method=record.method,
            reference=record.reference,
            audit=record.audit,
            grounds=record.grounds,
        )


def _group(arrays: Arrays, prefix: str) -> Arrays:
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
