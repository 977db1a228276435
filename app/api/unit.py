"""The main job in Python: f from a source, γ of a unit, estimates."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from numbers import Integral, Real
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from softcal.app.api.recording import Recording, expect, recording_of
from softcal.app.api.registry import open_registry
from softcal.app.batch.calibrating import LotFacts, UnitInputs
from softcal.app.files.atomic import write_bytes
from softcal.core.errors import InputError, UnitRefused
from softcal.core.lot import Lot
from softcal.core.maps.config import DEFAULT
from softcal.core.maps.interface import Anchors
from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.network.training import fit_network as train_network
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.calibration import Calibration
from softcal.core.unit.estimate import estimate
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import SourceModel, make_source_model
from softcal.core.unit.verdict import Release, stated_limit

if TYPE_CHECKING:
    import pandas as pd

    from softcal.app.export.calibrated_unit import CalibratedUnit
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


@dataclass(frozen=True, eq=False, repr=False)
class Unit:
    """One calibrated unit: it turns its own output into the reference.

    Args:
        network: the shared network f.
        calibration: the unit's map, interval, forecast and decision.
        source: recording of the source that f was trained on.
        recording: the one the unit was calibrated from.
        kept: what the registry knows of it; None for a unit that was calibrated here.
    """

    network: Network
    calibration: Calibration
    source: LabelledRecording
    recording: OutputRecording
    kept: "CalibratedUnit | None" = None

    def __repr__(self) -> str:
        error = "" if self.predicted_rmse is None else f", RMSE {self.predicted_rmse:.3g} {self.network.reference_unit}"
        return f"<Unit {self.serial}: {self.verdict}, {self.family}{error}>"

    @property
    def sample_rate_Hz(self) -> float:
        """Sample rate of the recordings it takes."""
        return self.recording.sample_rate_Hz

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
            recording: a `Recording`, a DataFrame with a column `output`, or the output alone: (n,) array, list or
                Series at the unit's sample rate. pandas keeps its index.

        Returns:
            `t_s`, `estimate`, `lower`, `upper` (a 90 % interval, in the reference unit) and `flag` (empty where a row
            is trusted). The first 14 rows have no full window: their estimate is NaN.

        Raises:
            InputError: the output is unusable, or in another physical unit.
        """
        import pandas as pd

        estimates = estimate(self.network, self.calibration, self._recording(recording).unlabelled)
        columns = {name: getattr(estimates, name) for name in ("t_s", "estimate", "lower", "upper", "flag")}
        return pd.DataFrame(columns, index=recording.index if hasattr(recording, "iloc") else None)

    def rmse(self, recording: Any) -> float:
        """Return the error against the reference of a recording, in the reference unit, over rows with an estimate."""
        labelled = self._recording(recording).labelled
        estimates, rows = estimate(self.network, self.calibration, labelled.unlabelled), labelled.unlabelled.window_rows
        return rmse(estimates.estimate[rows], labelled.reference[rows])

    def _recording(self, given: Any) -> Recording:
        facts = {"sample_rate_Hz": self.sample_rate_Hz, "serial": self.serial, "output_unit": self.network.output_unit}
        return recording_of(given, "recording", **facts)

    def to_frame(self) -> "pd.DataFrame":
        """Return one row: serial, verdict, family, errors and why; `pandas.concat` of units makes a lot."""
        import pandas as pd

        made, scores = self.calibration, self.calibration.scores
        row = {
            "serial": self.serial,
            "verdict": self.verdict,
            "family": self.family,
            "predicted_rmse": made.predicted_rmse,
            "before_rmse": None if scores is None else scores.before,
            "after_rmse": None if scores is None else scores.after,
            "reasons": "; ".join(self.reasons),
        }
        return pd.DataFrame([row])

    def save(self, path: str | Path) -> None:
        """Write the unit into one file, whole or not at all: a registry that holds this unit, its source and network.

        Every command takes the file, too: `softcal export --registry sqlite:///FILE --serial S`.

        Raises:
            InputError: the file cannot be written.
        """
        with TemporaryDirectory(prefix="softcal-") as folder:
            with self._registry(Path(folder)):
                pass
            write_bytes(Path(path), (Path(folder) / _FILE).read_bytes())

    @classmethod
    def load(cls, path: str | Path, serial: str | None = None) -> "Unit":
        """Read a unit that `save` wrote, or one of a registry's file.

        Args:
            path: the file.
            serial: needed where the file holds several units.

        Raises:
            InputError: there is no such file, or several units in it and `serial` is not given.
            RegistryError: the file is no registry, or damaged.
        """
        if not Path(path).is_file():
            raise InputError(f"{path}: there is no such file")
        with open_registry(f"sqlite:///{Path(path)}") as registry:
            units = {unit.serial for lot in registry.lots.ids() for unit in registry.lots.units(lot) if unit.revision}
            if serial is None and len(units) != 1:
                raise InputError(f"{path} holds {len(units)} calibrated units; name one of them by serial=")
            return cls.from_registry(registry, serial or units.pop())

    def export(self, out: str | Path, *formats: str, release: str = "pass") -> list[Path]:
        """Write calibration files, as `softcal export` does.

        Args:
            out: folder.
            formats: json (by default), c, blob, hex, onnx, pdf, dcc, or a plug-in's.
            release: `pass`, or `conditional` to write what a device takes of a conditional unit too.

        Returns:
            The files of this unit.

        Raises:
            InputError: a format or a word that is not known, or a folder that cannot be written.
            UnitRefused: its verdict or its map forbids a file; nothing that gives numbers was written.
        """
        from softcal.app.export.calibrated_unit import ExportOptions
        from softcal.app.export.export import export_units

        if release not in tuple(Release):
            raise InputError(f"release is {release!r}; pass or conditional was expected")
        if self.kept is not None:
            self.kept.check_stands()
        options = ExportOptions(release=Release(release))
        with TemporaryDirectory(prefix="softcal-") as folder, self._registry(Path(folder)) as registry:
            (done,) = export_units(registry, [self.serial], formats or ("json",), Path(out), options)
        if done.refusal is not None:
            raise UnitRefused(done.refusal)
        return [Path(out) / name for name in done.files]

    @contextmanager
    def _registry(self, folder: Path) -> "Iterator[Registry]":
        source, record = self.source, self.calibration.to_record("", self.recording.sha256)
        if source.serial == self.serial:
            source = replace(source, unlabelled=replace(source.unlabelled, serial=f"source-of-{self.serial}"))
        raw = source.unlabelled
        lot = Lot(
            "python",
            source.serial,
            raw.sample_rate_Hz,
            reference_unit=source.reference_unit,
            output_unit=raw.output_unit,
        )
        lot = lot if self.kept is None else self.kept.lot
        with open_registry(f"sqlite:///{folder / _FILE}", create=True) as registry:
            registry.lots.add(lot)
            training = {"source_recording_sha256": registry.recordings.add(lot.id, source, "source")}
            registry.networks.add(lot.id, self.network, {}, training, self.network.id)
            registry.recordings.add(lot.id, self.recording, "unit")
            registry.calibrations.add(lot.id, record)
            yield registry

    @classmethod
    def from_registry(
        cls, registry: "Registry", serial: str, revision: int | None = None, lot: str | None = None
    ) -> "Unit":
        """Load a unit: the revision in use, or an older one.

        Raises:
            InputError: the registry does not know it, or knows it in several lots and `lot` is not given.
        """
        from softcal.app.export.calibrated_unit import ExportOptions, UnitLoader

        kept = UnitLoader(registry, ExportOptions(revision=revision, lot_id=lot)).load(serial)
        return cls(kept.network, kept.calibration, kept.shared.source, kept.recording, kept)


_FILE = "unit.db"


def fit_network(
    source: Any, *, hidden: tuple[int, ...] = (120, 70, 35), seed: int = 0, members: int = 1
) -> SourceNetwork:
    """Train the shared network f on the source unit's recording.

    Args:
        source: `Recording` with a reference, or a DataFrame with columns `t_s, output, reference`.
        hidden: widths of the hidden layers; the default is the paper's (Kim et al. 2020).
        seed: equal seeds give equal networks on one machine.
        members: networks from consecutive seeds, averaged into one.

    Raises:
        InputError: no reference, too short, constant, saturated, or nothing to learn.
    """
    expect("hidden", hidden, (tuple, list), "widths of the hidden layers, for example (120, 70, 35),")
    for name, value in [("seed", seed), ("members", members), *(("hidden", width) for width in hidden)]:
        expect(name, value, Integral, "a whole number")
    labelled = recording_of(source, "source").labelled
    trained = train_network(labelled, NetworkConfig(hidden=tuple(hidden), seed=seed, members=members))
    model = make_source_model(labelled, trained.network, trained.validation_rows)
    return SourceNetwork(model, trained.validation_rows, trained.validation_rmse)


def fit_map(
    network: SourceNetwork,
    target: Any,
    *,
    family: str = DEFAULT,
    limit_rmse: float | None = None,
    anchors: "tuple[Any, Any] | pd.DataFrame | None" = None,
    audit: Any = None,
) -> Unit:
    """Fit the map of one unit from its output alone, and say how far it can be trusted.

    Args:
        network: from `fit_network`.
        target: `Recording` of the unit, a DataFrame with a column `output`, or the output itself at the source's
            rate. A reference, if it has one, is not looked at.
        family: `auto` lets the recording choose; or a family such as `affine` (`softcal batch --help` lists them).
        limit_rmse: largest acceptable error in the reference unit; by default derived from the source's own error.
        anchors: a few known loads: (outputs, references), or a DataFrame with these columns.
        audit: the same with a reference, of the same unit; it measures the error and fits nothing.

    Raises:
        UnitRefused: the recording allows no map; the message says why and what to do.
        InputError: the family is unknown, or units do not agree.
    """
    expect("network", network, SourceNetwork, "what softcal.fit_network returned")
    expect("family", family, str, "the name of a map family")
    if limit_rmse is not None:
        expect("limit_rmse", limit_rmse, Real, "a number in the reference unit")
    model = network.model
    if family != DEFAULT:
        method = Method(map=replace(model.method.map, family=family))
        model = make_source_model(model.source, model.network, network.held_out, method)
    known = model.source.unlabelled
    facts = {"sample_rate_Hz": known.sample_rate_Hz, "output_unit": known.output_unit}
    recording = recording_of(target, "target", **facts).unlabelled
    limit = stated_limit(network.reference_unit, limit_rmse)
    measured = None if audit is None else recording_of(audit, "audit", **facts).labelled
    loads = None
    if anchors is not None:
        try:
            table: Any = anchors
            pair = (table["output"], table["reference"]) if hasattr(table, "columns") else table
            output, reference = (np.asarray(values, dtype=np.float64) for values in pair)
        except (TypeError, ValueError, KeyError) as error:
            raise InputError(
                f"anchors is a {type(anchors).__name__} that is not understood ({error}); (outputs, references) or a "
                "DataFrame with columns output, reference was expected"
            ) from error
        if output.shape != reference.shape or output.ndim != 1 or not len(output):
            raise InputError(
                f"anchors: {output.shape} outputs and {reference.shape} references; as many of both, at least 1"
            )
        loads = Anchors(output, reference)
    (problem,) = LotFacts((model,), limit).problems(recording, UnitInputs(loads, audit=measured))
    return Unit(model.network, calibrate(problem), model.source, recording)
