"""The result of calibrating one unit: what the registry keeps, what estimates and exports start from."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softcal.core.identity import Settings
from softcal.core.maps.interface import UnitMap, map_sha256
from softcal.core.metrics import finite_or_none
from softcal.core.unit.health import OutputLimits
from softcal.core.unit.uncertainty import ErrorForecast, Interval
from softcal.core.unit.verdict import VERDICTS, Verdict


@dataclass(frozen=True, eq=False)
class CalibrationRecord:
    """One calibration of one unit as plain values: arrays, JSON settings and numbers. The registry stores it whole.

    Args:
        serial: the unit's serial.
        network_id: content hash of the shared network f it belongs to.
        family: family of the map γ (`maps.catalogue`).
        map_sha256: content hash of the map alone.
        arrays: parameters of the map (names `map.*`), of the interval and support model (names `interval.*`).
        settings: JSON values beside the arrays, grouped as {"map": {...}, "interval": {...}, "config": {...}}.
        predicted_rmse: forecast of the error against the reference, in the reference unit; None where none can be made.
        before_rmse, after_rmse, own_rmse: scores on an audit recording, in the reference unit; None without an audit.
        verdict: pass, conditional, fail or retest.
        reasons: why, in words, most important first.
        evidence: numbers the verdict rests on.
        input_sha256: content hash of everything that went in (recording, network, configuration): equal input, equal
            result, so that finished work is found again.
        recording_sha256: content hash of the unit's recording.
        fit_s: seconds the fit took.
    """

    serial: str
    network_id: str
    family: str
    map_sha256: str
    arrays: Mapping[str, NDArray[np.generic]]
    settings: Settings
    predicted_rmse: float | None
    verdict: str
    reasons: tuple[str, ...]
    input_sha256: str
    recording_sha256: str
    before_rmse: float | None = None
    after_rmse: float | None = None
    own_rmse: float | None = None
    fit_s: float | None = None
    evidence: Mapping[str, float | str | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.verdict not in VERDICTS:
            raise ValueError(f"verdict {self.verdict!r} is none of {', '.join(VERDICTS)}")


@dataclass(frozen=True, eq=False)
class Calibration:
    """The calibration of one unit, ready to estimate with.

    Args:
        serial: the unit's serial.
        network_id: content hash of the shared network f it belongs to.
        unit_map: the map γ.
        interval: 90 % interval of its estimates.
        output_limits: where the raw output stops to be believable.
        forecast: error forecast without labels, in the reference unit; None where none can be made.
        verdict: what was decided, and why.
        evidence: numbers and words behind it.
        config: JSON settings of the method.
    """

    serial: str
    network_id: str
    unit_map: UnitMap
    interval: Interval
    output_limits: OutputLimits
    forecast: ErrorForecast | None
    verdict: Verdict
    evidence: Mapping[str, float | str | None]
    config: Settings

    @property
    def predicted_rmse(self) -> float | None:
        """Forecast of the error against a reference, in the reference unit."""
        return None if self.forecast is None else self.forecast.rmse

    def to_record(
        self,
        input_sha256: str,
        recording_sha256: str,
        fit_s: float | None = None,
        before_rmse: float | None = None,
        after_rmse: float | None = None,
        own_rmse: float | None = None,
    ) -> CalibrationRecord:
        """Return the calibration as plain values, with the identities and scores that the caller knows."""
        arrays = {f"map.{name}": array for name, array in self.unit_map.arrays().items()}
        arrays |= {f"interval.{name}": array for name, array in self.interval.arrays().items()}
        limits = {name: finite_or_none(value) for name, value in vars(self.output_limits).items()}
        settings = {
            "map": dict(self.unit_map.settings()),
            "interval": {**self.interval.settings(), "output_limits": limits},
            "config": dict(self.config),
            "forecast": None if self.forecast is None else vars(self.forecast),
            "four_word": self.verdict.four_word,
        }
        return CalibrationRecord(
            serial=self.serial,
            network_id=self.network_id,
            family=self.unit_map.family,
            map_sha256=map_sha256(self.unit_map),
            arrays=arrays,
            settings=settings,
            predicted_rmse=self.predicted_rmse,
            verdict=self.verdict.word,
            reasons=self.verdict.reasons,
            input_sha256=input_sha256,
            recording_sha256=recording_sha256,
            before_rmse=before_rmse,
            after_rmse=after_rmse,
            own_rmse=own_rmse,
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

        settings = {name: _mapping(record.settings, name) for name in ("map", "interval", "config")}
        limits = _mapping(settings["interval"], "output_limits")
        forecast = record.settings["forecast"]
        return cls(
            serial=record.serial,
            network_id=record.network_id,
            unit_map=map_from_arrays(record.family, _group(record.arrays, "map."), settings["map"]),
            interval=Interval.from_arrays(_group(record.arrays, "interval."), settings["interval"]),
            output_limits=OutputLimits(
                rail_low=_number(limits["rail_low"], -np.inf),
                rail_high=_number(limits["rail_high"], np.inf),
                stuck_samples=int(str(limits["stuck_samples"])),
            ),
            forecast=None if forecast is None else ErrorForecast(**_mapping(record.settings, "forecast")),
            verdict=Verdict(record.verdict, str(record.settings["four_word"]), record.reasons),
            evidence=record.evidence,
            config=settings["config"],
        )


def _group(arrays: Mapping[str, NDArray[np.generic]], prefix: str) -> dict[str, NDArray[np.generic]]:
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def _mapping(settings: Settings, name: str) -> dict[str, Any]:
    return dict(settings[name])  # type: ignore[call-overload,no-any-return]


def _number(value: object, otherwise: float) -> float:
    return otherwise if value is None else float(str(value))
