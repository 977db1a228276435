"""The main job in Python: f from a source, γ of a unit, estimates."""

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from softcal.app.api.recording import Recording
from softcal.app.batch.calibrating import LotFacts, UnitFacts
from softcal.core.errors import InputError
from softcal.core.maps.config import DEFAULT
from softcal.core.maps.interface import Anchors
from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.network.training import fit_network as train_network
from softcal.core.recording import Array, OutputRecording
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.calibration import Calibration
from softcal.core.unit.estimate import estimate
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import SourceModel, make_source_model
from softcal.core.unit.verdict import stated_limit

if TYPE_CHECKING:
    import pandas as pd

    from softcal.core.maps.interface import UnitMap
    from softcal.db.registry import Registry


@dataclass(frozen=True, eq=False)
class SourceNetwork:
    """The shared network f with the source it was trained on: what every unit's map starts from."""

    model: SourceModel = field(repr=False)
    held_out: Any = field(repr=False)
    validation_rmse: float

    @property
    def network(self) -> Network:
        """f as plain arrays."""
        return self.model.network

    @property
    def reference_unit(self) -> str:
        """Physical unit of the estimates."""
        return self.network.reference_unit

    def predict(self, windows: Array) -> Array:
        """Estimate the reference for (n, 15) windows of the source, newest sample last: (n,)."""
        return self.network.evaluate(np.asarray(windows, dtype=np.float64))


@dataclass(frozen=True, eq=False)
class Unit:
    """One calibrated unit: it turns its own output into the reference.

    Args:
        network: the shared network f.
        calibration: the unit's map, interval, forecast and decision.
        sample_rate_Hz: of the recordings it takes.
    """

    network: Network = field(repr=False)
    calibration: Calibration = field(repr=False)
    sample_rate_Hz: float

    @property
    def serial(self) -> str:
        """Name of the unit."""
        return self.calibration.serial

    @property
    def verdict(self) -> str:
        """pass, conditional, fail or retest."""
        return str(self.calibration.decision.verdict)

    @property
    def reasons(self) -> list[str]:
        """Why, most important first."""
        return [str(reason) for reason in self.calibration.decision.reasons]

    @property
    def predicted_rmse(self) -> float | None:
        """Forecast of the error against a reference, without labels, in the reference unit; None where none is made."""
        return self.calibration.predicted_rmse

    @property
    def map(self) -> "UnitMap":
        """The map γ from windows of the unit to windows of the source."""
        return self.calibration.unit_map

    @property
    def family(self) -> str:
        """Name of the map's family."""
        return self.calibration.unit_map.family

    def estimate(self, recording: Any) -> "pd.DataFrame":
        """Estimate the reference, sample by sample.

        Args:
            recording: a `Recording`, or the output alone: (n,) array, list or Series at the unit's sample rate. A
                Series keeps its index.

        Returns:
            `t_s`, `estimate`, `lower`, `upper` (a 90 % interval, in the reference unit) and `flag` (empty where a row
            is trusted). The first 14 rows have no full window: their estimate is NaN.

        Raises:
            InputError: the output is unusable, or in another physical unit.
        """
        import pandas as pd

        found = estimate(self.network, self.calibration, self._recording(recording))
        columns = {name: getattr(found, name) for name in ("t_s", "estimate", "lower", "upper", "flag")}
        return pd.DataFrame(columns, index=getattr(recording, "index", None))

    def rmse(self, recording: Recording) -> float:
        """Return the error against the reference of a recording, in the reference unit, over rows with an estimate."""
        found = estimate(self.network, self.calibration, recording.unlabelled)
        rows = recording.unlabelled.window_rows
        return rmse(found.estimate[rows], recording.labelled.reference[rows])

    def _recording(self, recording: Any) -> OutputRecording:
        if isinstance(recording, Recording):
            return recording.unlabelled
        output_unit = self.network.output_unit
        rate_Hz = self.sample_rate_Hz
        return Recording(recording, sample_rate_Hz=rate_Hz, serial=self.serial, output_unit=output_unit).unlabelled

    @classmethod
    def from_registry(
        cls, registry: "Registry", serial: str, revision: int | None = None, lot: str | None = None
    ) -> "Unit":
        """Load a unit: the revision in use, or an older one.

        Raises:
            InputError: the registry does not know it, or knows it in several lots and `lot` is not given.
        """
        from softcal.app.registry.unit import calibrated_unit

        facts, network, calibration = calibrated_unit(registry, serial, revision, lot)
        return cls(network, calibration, facts.sample_rate_Hz)


def fit_network(
    source: Recording, *, hidden: tuple[int, ...] = (120, 70, 35), seed: int = 0, members: int = 1
) -> SourceNetwork:
    """Train the shared network f on the source unit's recording.

    Args:
        source: recording with a reference.
        hidden: widths of the hidden layers; the default is the paper's (Kim et al. 2020).
        seed: equal seeds give equal networks on one machine.
        members: networks from consecutive seeds, averaged into one.

    Raises:
        InputError: no reference, too short, constant, saturated, or nothing to learn.
    """
    trained = train_network(source.labelled, NetworkConfig(hidden=tuple(hidden), seed=seed, members=members))
    model = make_source_model(source.labelled, trained.network, trained.validation_rows)
    return SourceNetwork(model, trained.validation_rows, trained.validation_rmse)


def fit_map(
    network: SourceNetwork,
    target: Recording,
    *,
    family: str = DEFAULT,
    limit_rmse: float | None = None,
    anchors: "tuple[Any, Any] | pd.DataFrame | None" = None,
    audit: Recording | None = None,
) -> Unit:
    """Fit the map of one unit from its output alone, and say how far it can be trusted.

    Args:
        network: from `fit_network`.
        target: recording of the unit; its reference, if it has one, is not looked at.
        family: `auto` lets the recording choose; or a family such as `affine` (`softcal batch --help` lists them).
        limit_rmse: largest acceptable error in the reference unit; by default derived from the source's own error.
        anchors: a few known loads: (outputs, references), or a DataFrame with these columns.
        audit: recording with a reference of the same unit; it measures the error and fits nothing.

    Raises:
        UnitRefused: the recording allows no map; the message says why and what to do.
        InputError: the family is unknown, or units do not agree.
    """
    model = network.model
    if family != DEFAULT:
        method = Method(map=replace(model.method.map, family=family))
        model = make_source_model(model.source, model.network, network.held_out, method)
    if target.output_unit != model.network.output_unit:
        raise InputError(f"target output is in {target.output_unit}, the source's in {model.network.output_unit}")
    limit = stated_limit(network.reference_unit, limit_rmse)
    known = UnitFacts(_anchors(anchors), audit=None if audit is None else audit.labelled)
    (problem,) = LotFacts((model,), limit).problems(target.unlabelled, known)
    return Unit(model.network, calibrate(problem), target.unlabelled.sample_rate_Hz)


def _anchors(known: Any) -> Anchors | None:
    if known is None:
        return None
    pair = (known["output"], known["reference"]) if hasattr(known, "columns") else known
    output, reference = (np.asarray(values, dtype=np.float64) for values in pair)
    if output.shape != reference.shape or output.ndim != 1 or not len(output):
        raise InputError(
            f"anchors: {output.shape} outputs and {reference.shape} references; as many of both, at least 1"
        )
    return Anchors(output, reference)
