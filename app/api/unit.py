"""A calibrated unit in Python: verdict and reasons, estimates, figure, files."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from softcal.app.api.arguments import file_path, show_value, text
from softcal.app.api.display import html_table, plotting
from softcal.app.api.recording import Recording
from softcal.app.api.recording_input import labelled_of, recording_of
from softcal.app.api.registry import open_registry
from softcal.app.files.atomic import write_bytes
from softcal.app.registry.lot_recordings import audit_of
from softcal.core.errors import InputError, UnitRefused
from softcal.core.lot import Lot
from softcal.core.metrics import rmse
from softcal.core.network.network import Network
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.estimate import estimate
from softcal.core.unit.state import UnitState
from softcal.core.unit.verdict import Release

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

    from softcal.app.export.calibrated_unit import CalibratedUnit
    from softcal.core.maps.interface import UnitMap
    from softcal.db.registry import Registry


@dataclass(frozen=True, eq=False, repr=False)
class Unit:
    """One calibrated unit: it turns its own output into the reference.

    >>> import softcal
    >>> source, target = softcal.simulate_recordings()
    >>> unit = softcal.fit_map(softcal.fit_network(source, hidden=(8,)), target)
    >>> unit.serial, unit.verdict in ("pass", "conditional", "fail", "retest"), len(unit.reasons) > 0
    ('S2', True, True)

    Args:
        network: the shared network f.
        state: the unit's fit, what was done to it since, and what follows from both.
        source: recording of the source that f was trained on.
        recording: the one the unit was calibrated from.
        audit: recording that measured its error; None without one.
        audited_at: when that was measured, UTC; None where nobody says.
        stored_unit: what the registry knows of it; None for a unit that was calibrated here.
    """

    network: Network
    state: UnitState
    source: LabelledRecording
    recording: OutputRecording
    audit: LabelledRecording | None = None
    audited_at: datetime | None = None
    stored_unit: "CalibratedUnit | None" = None

    def __repr__(self) -> str:
        return f"<Unit {self.serial}: {self.verdict}, {self.family}{self._error(', predicted RMSE ')}>"

    def _repr_html_(self) -> str:
        rows = [("verdict", self.verdict), ("map", self.family), ("predicted RMSE", self._error())]
        return html_table(f"Unit {self.serial}", [*rows, *(("", reason) for reason in self.reasons)])

    def _error(self, before: str = "") -> str:
        return f"{before}{self.predicted_rmse:.3g} {self.network.reference_unit}"

    @property
    def sample_rate_Hz(self) -> float:
        """Sample rate of the recordings it takes."""
        return self.recording.sample_rate_Hz

    @property
    def serial(self) -> str:
        """Name of the unit."""
        return self.state.serial

    @property
    def verdict(self) -> str:
        """pass, conditional, fail or retest."""
        return str(self.state.verdict)

    @property
    def reasons(self) -> list[str]:
        """Why, most important first."""
        return [str(reason) for reason in self.state.decision.reasons]

    @property
    def predicted_rmse(self) -> float:
        """Forecast of the error against a reference, without labels, in the reference unit."""
        return self.state.predicted_rmse

    @property
    def map(self) -> "UnitMap":
        """The map γ from windows of the unit to windows of the source."""
        return self.state.unit_map

    @property
    def family(self) -> str:
        """Name of the map's family."""
        return self.state.fit.family

    def estimate(self, recording: Any) -> "pd.DataFrame":
        """Estimate the reference, sample by sample.

        >>> import softcal
        >>> source, target = softcal.simulate_recordings()
        >>> unit = softcal.fit_map(softcal.fit_network(source, hidden=(8,)), target)
        >>> list(unit.estimate(target.output).columns)
        ['t_s', 'estimate', 'lower', 'upper', 'flag']

        Args:
            recording: a `Recording`, a DataFrame with a column `output`, or the output alone: (n,) array, list or
                Series at the unit's sample rate. pandas keeps its index.

        Returns:
            A row for every sample: `t_s`, `estimate`, `lower`, `upper` (a 90 % interval, in the reference unit) and
            `flag` (empty where a row is trusted). The first 14 rows have no full window: their estimate is NaN, as is
            that of a missing sample, which is `invalid`.

        Raises:
            InputError: the output is unusable, or in another physical unit.
        """
        import pandas as pd

        target = self._recording(recording)
        estimates = estimate(self.network, self.state, target.unlabelled).spread(target.t_s, target.rows)
        columns = {name: getattr(estimates, name) for name in ("t_s", "estimate", "lower", "upper", "flag")}
        return pd.DataFrame(columns, index=recording.index if hasattr(recording, "iloc") else None)

    def rmse(self, recording: Any) -> float:
        """Return the error against the reference of a recording, in the reference unit, over rows with an estimate.

        >>> import softcal
        >>> source, target = softcal.simulate_recordings()
        >>> unit = softcal.fit_map(softcal.fit_network(source, hidden=(8,)), target)
        >>> unit.rmse(target) < 1.0
        True

        Raises:
            InputError: the recording has no reference.
        """
        labelled = labelled_of(self._recording(recording), "recording", "Unit.rmse")
        estimates, rows = (
            estimate(self.network, self.state, labelled.unlabelled),
            labelled.unlabelled.window_rows,
        )
        return rmse(estimates.estimate[rows], labelled.reference[rows])

    def _recording(self, data: Any) -> Recording:
        units = {"output_unit": self.network.output_unit, "reference_unit": self.network.reference_unit}
        return recording_of(data, "recording", self.sample_rate_Hz, serial=self.serial, **units)

    def to_frame(self) -> "pd.DataFrame":
        """Return one row: serial, verdict, map family, predicted and measured RMSE, and the reasons.

        >>> import softcal
        >>> source, target = softcal.simulate_recordings()
        >>> unit = softcal.fit_map(softcal.fit_network(source, hidden=(8,)), target)
        >>> unit.to_frame().loc[0, "serial"]
        'S2'
        """
        return unit_frame([unit_row(self)])

    def plot(self, recording: Any = None) -> "go.Figure":  # noqa: V105
        """Draw the map, the output over the load, and the estimate with its 90 % band, as a Plotly figure.

        >>> import softcal
        >>> source, target = softcal.simulate_recordings()
        >>> unit = softcal.fit_map(softcal.fit_network(source, hidden=(8,)), target)
        >>> unit.plot(target).layout.xaxis2.title.text
        'force [N]'

        Args:
            recording: as `estimate` takes it; by default the one the unit was calibrated from. The load is its
                reference, or the estimate where it has none.

        Raises:
            ModuleNotFoundError: plotly is not installed; the line names the extra that brings it.
        """
        with plotting("Unit.plot"):
            from softcal.app.api.figures import draw_unit
        from softcal.app.views.unit import UnitSignals

        target = None if recording is None else self._recording(recording)
        raw = self.recording if target is None else target.unlabelled
        estimates = estimate(self.network, self.state, raw)
        signals = UnitSignals(self.state, self._lot, self.source, raw, estimates)
        reference = None if target is None or target.reference is None else target.reference[target.rows]
        return draw_unit(signals, reference, f"Unit {self.serial}: {self.verdict}{self._error(', predicted RMSE ')}")

    def save(self, path: str | Path) -> None:
        """Write the unit into one file, whole or not at all: a registry that holds this unit, its source and network.

        Every command takes the file, too: `softcal export --registry sqlite:///FILE --serial S`.

        >>> import pathlib, tempfile, softcal
        >>> source, target = softcal.simulate_recordings()
        >>> unit = softcal.fit_map(softcal.fit_network(source, hidden=(8,)), target)
        >>> path = pathlib.Path(tempfile.mkdtemp(), "S2.db")
        >>> unit.save(path)
        >>> softcal.Unit.load(path).predicted_rmse == unit.predicted_rmse
        True

        Raises:
            InputError: the file cannot be written.
        """
        file = file_path("path", path)
        with TemporaryDirectory(prefix="softcal-") as folder:
            with self._registry(Path(folder)):
                pass
            write_bytes(file, (Path(folder) / _UNIT_DATABASE).read_bytes())

    @classmethod
    def load(cls, path: str | Path, serial: str | None = None) -> "Unit":
        """Read a unit that `save` wrote, or one of a registry's file.

        >>> import softcal
        >>> softcal.Unit.load("nowhere.db")
        Traceback (most recent call last):
        ...
        softcal.core.errors.InputError: nowhere.db: there is no such file

        Args:
            path: the file.
            serial: needed where the file holds several units.

        Raises:
            InputError: there is no such file, or several units in it and `serial` is not given.
            RegistryError: the file is no registry, or damaged.
        """
        file = file_path("path", path)
        if not file.is_file():
            raise InputError(f"{file}: there is no such file")
        serial = None if serial is None else text("serial", serial)
        with open_registry(f"sqlite:///{file}") as registry:
            units = {unit.serial for lot in registry.lots.ids() for unit in registry.lots.units(lot) if unit.revision}
            if serial is None and len(units) != 1:
                raise InputError(f"{file} holds {len(units)} calibrated units; name one of them by serial=")
            return cls.from_registry(registry, serial or units.pop())

    def export(self, out: str | Path, *formats: str, release: str = "pass") -> list[Path]:  # noqa: V105
        """Write calibration files, as `softcal export` does.

        >>> import tempfile, softcal
        >>> source, target = softcal.simulate_recordings()
        >>> unit = softcal.fit_map(softcal.fit_network(source, hidden=(8,)), target, limit_rmse=2.0)
        >>> unit.export(tempfile.mkdtemp(), "json", release="conditional")[0].name
        'unit-S2.json'

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

        folder = file_path("out", out)
        names = [text("format", name) for name in formats] or ["json"]
        if release not in tuple(Release):
            raise InputError(f"release is {show_value(release)}; pass or conditional was expected")
        if self.stored_unit is not None:
            self.stored_unit.check_not_withdrawn()
        options = ExportOptions(release=Release(release))
        with TemporaryDirectory(prefix="softcal-") as scratch, self._registry(Path(scratch)) as registry:
            (exported,) = export_units(registry, [self.serial], names, folder, options)
        if exported.refusal is not None:
            raise UnitRefused(exported.refusal)
        return [folder / name for name in exported.files]

    @property
    def _stored_source(self) -> LabelledRecording:
        # A registry holds one unit of a serial: the source of the same name gets another one.
        if self.source.serial != self.serial:
            return self.source
        raw = replace(self.source.unlabelled, serial=f"source-of-{self.serial}")
        return replace(self.source, unlabelled=raw)

    @property
    def _lot(self) -> Lot:
        if self.stored_unit is not None:
            return self.stored_unit.lot
        source = self._stored_source
        units = {"reference_unit": source.reference_unit, "output_unit": source.unlabelled.output_unit}
        # One that nobody stated follows from the source again.
        limit_rmse = self.state.limit.maximum_rmse if self.state.limit.is_stated else None
        return Lot("python", source.serial, source.unlabelled.sample_rate_Hz, **units, limit_rmse=limit_rmse)

    @contextmanager
    def _registry(self, folder: Path) -> "Iterator[Registry]":
        source, lot = self._stored_source, self._lot
        with open_registry(f"sqlite:///{folder / _UNIT_DATABASE}", create=True) as registry:
            registry.lots.add(lot)
            training = {"source_recording_sha256": registry.recordings.add(lot.id, source, "source")}
            registry.networks.add(lot.id, self.network, {}, training, self.network.id)
            registry.recordings.add(lot.id, self.recording, "unit")
            if self.audit is not None:
                registry.recordings.add(lot.id, self.audit, "audit", measured_at=self.audited_at)
            registry.calibrations.add(lot.id, self.state)
            yield registry

    @classmethod
    def from_registry(
        cls, registry: "Registry", serial: str, revision: int | None = None, lot: str | None = None
    ) -> "Unit":
        """Load a unit of a registry: the revision in use, or an older one.

        >>> import pathlib, tempfile, softcal
        >>> source, target = softcal.simulate_recordings()
        >>> path = pathlib.Path(tempfile.mkdtemp(), "S2.db")
        >>> softcal.fit_map(softcal.fit_network(source, hidden=(8,)), target).save(path)
        >>> with softcal.open_registry(f"sqlite:///{path}") as registry:
        ...     unit = softcal.Unit.from_registry(registry, "S2")
        >>> unit.serial
        'S2'

        Raises:
            InputError: the registry does not know it, or knows it in several lots and `lot` is not given.
        """
        from softcal.app.export.calibrated_unit import ExportOptions, UnitLoader

        stored_unit = UnitLoader(registry, ExportOptions(revision=revision, lot_id=lot)).load(serial)
        audit_record = stored_unit.state.audit
        entries = registry.recordings.of_lot(stored_unit.lot.id, serial, "audit")
        entry = next(
            (one for one in entries if audit_record is not None and one.sha256 == audit_record.recording_sha256), None
        )
        audit, measured_at = audit_of(registry, entry), None if entry is None else entry.observed_at
        return cls(
            stored_unit.network,
            stored_unit.state,
            stored_unit.shared.source,
            stored_unit.recording,
            audit,
            measured_at,
            stored_unit,
        )


def unit_row(unit: Unit) -> dict[str, Any]:
    """Return the values of a unit's row by their column."""
    errors = unit.state.errors
    return {
        "serial": unit.serial,
        "verdict": unit.verdict,
        "family": unit.family,
        "predicted_rmse": unit.predicted_rmse,
        "before_rmse": errors["before_rmse"],
        "after_rmse": errors["after_rmse"],
        "reasons": "; ".join(unit.reasons),
    }


def unit_frame(rows: Iterable[Mapping[str, Any]]) -> "pd.DataFrame":
    """Return units as a table, numbers as numbers where some unit has none."""
    import pandas as pd

    table = pd.DataFrame([dict(row) for row in rows])
    errors = ["predicted_rmse", "before_rmse", "after_rmse"]
    return table.astype(dict.fromkeys(errors, np.float64))


_UNIT_DATABASE = "unit.db"
