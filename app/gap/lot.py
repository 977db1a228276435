"""A rig's lot on disk: its units diagnosed together, and calibrated beside lots of its twins."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from softcal.app.files.case_folder import open_case
from softcal.app.files.lot_folder import open_lot_folder
from softcal.app.gap.diagnose import read_twin
from softcal.core.errors import InputError
from softcal.core.gap.case import CHANNELS, Case
from softcal.core.lot_diagnosis import MIN_UNITS, LotDiagnosis, diagnose_lot
from softcal.core.transfer import CalibrationWorth, LotUnit, PressedLot, Transfer, calibration_worth, transfer

AUDIT = "audit"


@dataclass(frozen=True, eq=False)
class LotReport:
    """A lot's diagnosis, and what its causes are worth to the units that follow them."""

    diagnosis: LotDiagnosis
    calibration: tuple[CalibrationWorth, ...]

    def record(self) -> dict[str, object]:
        """Return JSON values."""
        return {**self.diagnosis.report(), "calibration": [one.record() for one in self.calibration]}


def diagnose_lot_folder(folder: Path, on_progress: Callable[[str], None] = lambda _: None) -> LotReport:
    """Read every unit's case, diagnose them together, and train f where a unit has an audit.

    Args:
        folder: one case folder per unit, each with `runs/` and, where there is one, `audit/` in the layout of a case.

    Raises:
        InputError: fewer than two cases, cases of different protocols, one case twice, or a case that cannot be read.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder; a lot holds one case folder per unit")
    folders = sorted(p for p in folder.iterdir() if p.is_dir() and (p / "runs").is_dir())
    if len(folders) < MIN_UNITS:
        count = f"{len(folders)} case folder{'' if len(folders) == 1 else 's'}"
        raise InputError(f"{folder}: {count} with runs/<n>/; a lot holds at least {MIN_UNITS}, one per unit")
    cases = {case_folder.name: open_case(case_folder) for case_folder in folders}
    serials: dict[str, str] = {}
    for name, case in cases.items():
        if case.serial in serials:
            twice = f"{serials[case.serial]} and {name} are both of unit {case.serial}"
            raise InputError(f"{folder}: {twice}; one case per unit was expected; remove one or correct its serial")
        serials[case.serial] = name
    first, *others = cases
    for name in others:
        for part, expected, other in zip(
            _PROTOCOL_SENTENCES, _protocol(cases[first]), _protocol(cases[name]), strict=True
        ):
            if expected != other:
                raise InputError(
                    f"{folder / name}: {part} {other}, but {expected} in {first}; "
                    "the units of a lot are pressed by one protocol; put the others into a folder of their own"
                )
    # Audits are read first: a bad one is told before the long part.
    audits = {name: open_case(folder / name / AUDIT) for name in cases if (folder / name / AUDIT).is_dir()}
    diagnosis = diagnose_lot(cases, on_progress)
    calibration = [
        calibration_worth(m.name, m.diagnosis.case, audits[m.name], m.fit, report=on_progress)
        for m in diagnosis.members
        if diagnosis.verdict in ("explained", "ambiguous") and m.follows and m.fit is not None and m.name in audits
    ]
    return LotReport(diagnosis, tuple(calibration))


_PROTOCOL_SENTENCES = ("runs are", "channels are", "electronics are")


def _protocol(case: Case) -> tuple[str, str, str]:
    """Return what the units of a lot have in common, in words."""
    runs = ", ".join(f"{run.kind}{f' ({run.profile})' if run.profile else ''}" for run in case.runs)
    channels = ", ".join(channel for channel in CHANNELS if case.has(channel))
    readout = case.readout
    supply = f"{readout.vref_V:g} V, {readout.adc_bits} bits, {readout.r_series_ohm:g} ohm"
    return runs, channels, f"{supply}, {readout.sensor_type}"


def check_transfer(report: Path, lot_folder: Path, seed: int, on_progress: Callable[[str], None]) -> Transfer:
    """Compare what the twins of a report foretell of calibration results with those on the rig.

    Args:
        report: of `softcal gap diagnose`; it holds the refitted base and the explained twin.
        lot_folder: units pressed on the rig, with audits and stage positions.

    Raises:
        InputError: the report holds no twins, or the lot lacks audits or stage positions.
    """
    base, explained = read_twin(report, "base_twin"), read_twin(report, "twin")
    folder = open_lot_folder(lot_folder)
    units = []
    for serial in folder.unit_paths:
        audit = folder.read_audit(serial)
        if audit is not None:
            units.append(LotUnit(folder.read_unit(serial), audit))
    if not units:
        raise InputError(f"{lot_folder}: no unit has a recording under audit/; the truth of at least one is needed")
    return transfer(PressedLot(folder.read_source(), tuple(units)), base, explained, seed, on_progress)
