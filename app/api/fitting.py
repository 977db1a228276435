"""Maps of one unit or of many in Python, each from its own output alone."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from softcal.app.api.arguments import column, expect, number, show_value, text
from softcal.app.api.network import SourceNetwork
from softcal.app.api.recording import COLUMNS, Recording, check_rate
from softcal.app.api.recording_input import labelled_of, recording_of, recording_with
from softcal.app.api.unit import Unit, unit_frame, unit_row
from softcal.app.calibration.unit_calibration import LotContext, UnitInputs
from softcal.core.errors import InputError, UnitRefused
from softcal.core.maps.catalogue import check_family
from softcal.core.maps.config import DEFAULT
from softcal.core.maps.interface import Anchors
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import make_source_model
from softcal.core.unit.verdict import Verdict, stated_limit

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class RefusedUnit:
    """A unit that got no map, and why."""

    serial: str
    verdict: str
    reason: str

    @property
    def row(self) -> dict[str, Any]:
        """The values of its row by their column."""
        missing = dict.fromkeys(("family", "predicted_rmse", "before_rmse", "after_rmse"))
        return {"serial": self.serial, "verdict": self.verdict, **missing, "reasons": self.reason}


@dataclass(frozen=True, eq=False, repr=False)
class UnitTable:
    """Units that were fitted each alone, one row a unit, in the order they were given.

    A unit whose recording cannot be used is a row as well: `retest` or `fail`, with its reason.

    >>> import softcal
    >>> source, *targets = softcal.simulate_recordings(units=2)
    >>> network = softcal.fit_network(source, hidden=(8,))
    >>> table = softcal.fit_map(network, [*targets, [0.5, 0.5]])
    >>> list(table), len(table)
    (['S2', 'S3', 'unit-3'], 3)
    >>> table["S2"].serial
    'S2'
    >>> table.to_frame().loc[2, ["verdict", "reasons"]].to_list()
    ['retest', '2 samples; at least 15 are needed to fill one window']
    """

    rows: tuple[Unit | RefusedUnit, ...]

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[str]:
        return (row.serial for row in self.rows)

    def __contains__(self, serial: object) -> bool:
        return any(row.serial == serial for row in self.rows)

    def __getitem__(self, serial: str) -> Unit:
        """Return the unit of a serial.

        Raises:
            UnitRefused: it got no map; the line says why.
            InputError: there is no unit of that serial; the line lists those there are.
        """
        for row in self.rows:
            if row.serial == serial:
                if isinstance(row, Unit):
                    return row
                raise UnitRefused(f"{row.serial}: {row.reason}")
        serials = list(self)
        more = ", ..." if len(serials) > 12 else ""
        raise InputError(f"there is no unit {serial!r}; the table has {', '.join(serials[:12])}{more}")

    @property
    def units(self) -> list[Unit]:
        """The units that have a map."""
        return [row for row in self.rows if isinstance(row, Unit)]

    def to_frame(self) -> "pd.DataFrame":
        """Return one row a unit: serial, verdict, map family, predicted and measured RMSE, and the reasons.

        >>> import softcal
        >>> source, target = softcal.simulate_recordings()
        >>> table = softcal.fit_map(softcal.fit_network(source, hidden=(8,)), {"S7": target})
        >>> table.to_frame()["serial"].to_list()
        ['S7']
        """
        return unit_frame(unit_row(row) if isinstance(row, Unit) else row.row for row in self.rows)

    def __repr__(self) -> str:
        counts = [(verdict, sum(row.verdict == verdict for row in self.rows)) for verdict in Verdict]
        return f"<UnitTable of {len(self)}: {', '.join(f'{n} {verdict}' for verdict, n in counts if n)}>"

    def _repr_html_(self) -> str:
        return str(self.to_frame().to_html(index=False, max_rows=40, float_format="{:.3g}".format, na_rep=""))


def fit_map(
    network: SourceNetwork,
    target: Any,
    *,
    sample_rate_Hz: Any = None,
    family: str = DEFAULT,
    limit_rmse: Any = None,
    anchors: Any = None,
    audit: Any = None,
    **recording: Any,
) -> Any:
    """Fit the map of a unit from its output alone, and say how far it can be trusted; or of many, each alone.

    >>> import softcal
    >>> source, target = softcal.simulate_recordings()
    >>> network = softcal.fit_network(source, hidden=(8,))
    >>> softcal.fit_map(network, target.output, serial="S2").serial
    'S2'

    A dict or a list of units gives a table:

    >>> table = softcal.fit_map(network, {"S2": target, "S3": target.output * 1.1})
    >>> table["S3"].serial, len(table.to_frame())
    ('S3', 2)

    Args:
        network: from `fit_network`.
        target: `Recording` of the unit, a DataFrame with a column `output`, or the output itself at the source's
            rate. A reference, if it has one, is not looked at. Or many of these: a dict by serial, or a list, where
            what has no serial is called `unit-1`, `unit-2` and so on by its position.
        sample_rate_Hz: samples a second, where the data have no time of their own; by default the source's.
        family: `auto` lets the recording choose; `exact` and `joint` are the paper's optimal transport, windows alone
            (eq. 3) or with their loads (eq. 5); `softcal batch --help` lists all.
        limit_rmse: largest acceptable error in the reference unit; by default derived from the source's own error.
        anchors: a few known loads: (outputs, references), or a DataFrame with these columns; for many units a dict of
            them by serial.
        audit: a recording of the same unit with a reference; it measures the error and fits nothing. For many units a
            dict of them by serial.
        recording: other arguments of `Recording`, or of `Recording.from_frame` for DataFrames.

    Returns:
        A `Unit`; for many a `UnitTable`, in which a unit that cannot be calibrated is a row with its reason.

    Raises:
        UnitRefused: the one recording allows no map; the message says why and what to do.
        InputError: the family is unknown, or units do not agree.
    """
    options = {"sample_rate_Hz": sample_rate_Hz, **recording}
    fit = _MapFit.prepare(network, family, limit_rmse)
    if not _is_many(target):
        return fit.fit_unit(recording_with(target, "target", options, fit.rate_Hz, **fit.units), anchors, audit)
    if "serial" in recording:
        raise InputError("serial= belongs to one unit; a dict {serial: recording} names many")
    serials, entries = _name_units(target, options)
    loads, audits = _by_serial("anchors", anchors, serials), _by_serial("audit", audit, serials)
    rows: list[Unit | RefusedUnit] = []
    for serial, (name, one) in zip(serials, entries, strict=True):
        try:
            unit = _recording_of_unit(one, name, serial, serials.count(serial), fit, options)
            rows.append(fit.fit_unit(unit, loads.get(serial), audits.get(serial)))
        except UnitRefused as error:
            rows.append(RefusedUnit(serial, str(Verdict.FAIL), str(error)))
        except InputError as error:
            rows.append(RefusedUnit(serial, str(Verdict.RETEST), str(error)))
    return UnitTable(tuple(rows))


def read_recordings(network: SourceNetwork, units: Any, options: Mapping[str, Any]) -> list[Recording]:
    """Return the recordings of many units, each with its own serial.

    Raises:
        InputError: it is one recording or none, a serial stands twice, or an output is unusable.
    """
    if not _is_many(units):
        raise InputError(
            f"units is {show_value(units)}; a dict {{serial: recording}} or a list of recordings was expected"
        )
    fit = _MapFit.prepare(network, DEFAULT, None)
    serials, entries = _name_units(units, options)
    return [
        _recording_of_unit(one, name, serial, serials.count(serial), fit, options)
        for serial, (name, one) in zip(serials, entries, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class _MapFit:
    """What all units of one call are fitted with."""

    lot: LotContext

    @classmethod
    def prepare(cls, network: SourceNetwork, family: str, limit_rmse: Any) -> "_MapFit":
        expect("network", network, SourceNetwork, "what softcal.fit_network returned")
        model = network.model
        if text("family", family) != DEFAULT:
            method = Method.with_family(check_family(family))
            model = make_source_model(model.source, model.network, network.held_out, method=method)
        limit = None if limit_rmse is None else number("limit_rmse", limit_rmse, "a number in the reference unit")
        return cls(LotContext((model,), stated_limit(network.reference_unit, limit)))

    @property
    def rate_Hz(self) -> float:
        return self.lot.source.source.unlabelled.sample_rate_Hz

    @property
    def units(self) -> dict[str, Any]:
        source = self.lot.source.source
        return {"output_unit": source.unlabelled.output_unit, "reference_unit": source.reference_unit}

    def fit_unit(self, recording: Recording, anchors: Any, audit: Any) -> Unit:
        measured, measured_at = None, None
        if audit is not None:
            audit_recording = recording_of(audit, "audit", self.rate_Hz, serial=recording.serial, **self.units)
            measured = labelled_of(replace(audit_recording, serial=recording.serial), "audit", "fit_map")
            measured_at = audit_recording.measured_at
        loads = None if anchors is None else _anchors(anchors)
        (problem,) = self.lot.problems(recording.unlabelled, UnitInputs(loads, audit=measured))
        model = self.lot.source
        return Unit(model.network, calibrate(problem), model.source, recording.unlabelled, measured, measured_at)


def _is_many(target: Any) -> bool:
    """Whether a target is a dict or a list of units, not the samples of one."""
    if isinstance(target, dict):
        if columns := [name for name in target if name in COLUMNS]:
            raise InputError(
                f"target is a dict of columns ({', '.join(columns)}); one unit is a pandas.DataFrame of them, many are "
                "{serial: recording}"
            )
        is_many, is_empty = True, not target
    else:
        is_sequence = isinstance(target, list | tuple)
        is_many = is_sequence and any(
            isinstance(one, Recording) or (hasattr(one, "__len__") and not isinstance(one, str | bytes))
            for one in target
        )
        is_empty = is_sequence and not target
    if is_empty:
        raise InputError(f"target is {show_value(target)}; it holds no unit and no sample")
    return is_many


def _name_units(units: Any, options: Mapping[str, Any]) -> tuple[list[str], list[tuple[Any, Any]]]:
    """Return the serials of many units, and each with the name that a dict gives it.

    Raises:
        InputError: an option of the call that no unit can have, or that one which is a `Recording` takes no more.
    """
    if options.get("sample_rate_Hz") is not None:
        check_rate(options["sample_rate_Hz"])
    for name in ("output_unit", "reference_unit"):
        if options.get(name) is not None:
            text(name, options[name])
    entries = [*units.items()] if isinstance(units, dict) else [(None, one) for one in units]
    usual = [one.serial if isinstance(one, Recording) else f"unit-{k}" for k, (_, one) in enumerate(entries, 1)]
    serials = [other if name is None else str(name) for (name, _), other in zip(entries, usual, strict=True)]
    for serial, (_, one) in zip(serials, entries, strict=True):
        if isinstance(one, Recording):
            recording_with(one, serial, options)
    return serials, entries


def _recording_of_unit(
    unit: Any, name: Any, serial: str, count: int, fit: _MapFit, options: Mapping[str, Any]
) -> Recording:
    """Return the recording of one unit of many under its serial; `InputError` where another has that serial too."""
    if count > 1:
        raise InputError(
            f"{count} units are called {serial!r}; give each its own serial: Recording(..., serial=...), or a dict "
            "{serial: recording}"
        )
    if name is not None:
        expect("serial", name, str, "text")
    if isinstance(unit, Recording):
        unit = replace(unit, serial=serial)
    return recording_with(unit, "target", options, fit.rate_Hz, serial=serial, **fit.units)


def _by_serial(name: str, values: Any, serials: Sequence[str]) -> Mapping[str, Any]:
    """Return what stands beside units of many by their serial; what belongs to none of them is refused."""
    if values is None:
        return {}
    expect(name, values, dict, "a dict by serial, as there are many units,")
    if unknown := [str(serial) for serial in values if serial not in serials]:
        raise InputError(f"{name} of {', '.join(unknown[:12])}: there is no unit of that serial among the targets")
    return dict(values)


def _anchors(data: Any) -> Anchors:
    pair: Any = data
    if hasattr(data, "columns"):
        if missing := [name for name in ("output", "reference") if name not in data.columns]:
            raise InputError(
                f"anchors is a table without {', '.join(missing)}; columns output, reference were expected"
            )
        pair = (data["output"], data["reference"])
    if not isinstance(pair, tuple | list) or len(pair) != 2:
        raise InputError(
            f"anchors is {show_value(data)}; (outputs, references), or a DataFrame with columns output, reference, was "
            "expected"
        )
    output, reference = column("anchors, outputs,", pair[0]), column("anchors, references,", pair[1])
    if len(output) != len(reference) or not len(output):
        raise InputError(f"anchors: {len(output)} outputs and {len(reference)} references; as many of both, at least 1")
    if not np.isfinite([output, reference]).all():
        raise InputError("anchors: a value is missing or not finite; every known load needs its output")
    return Anchors(output, reference)
