"""The main job on a simulated station: press, train, map, judge, register, export."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from softcal.app.batch.lot_work import BatchConfig
from softcal.app.batch.report import UnitResult
from softcal.app.files.atomic import whole_folder
from softcal.app.files.lot_folder import LotFolder, open_lot_folder, write_lot_toml
from softcal.app.files.recording_file import write_recording
from softcal.core.errors import InputError
from softcal.core.limit_text import LimitText
from softcal.core.lot import Lot
from softcal.core.profiles import source_profile, unit_profile
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.simulated_lot import draw_twins
from softcal.core.twin.simulate import Twin
from softcal.core.unit.budget import SIMULATED
from softcal.station.devices.bench import open_simulated_bench
from softcal.station.tasks.acquisition import record

TABLE_HEADER = (
    "unit",
    "verdict",
    "before [N]",
    "after [N]",
    "own [N]",
    "after/own, test rows",
    "before/own, test rows",
    "predicted [N]",
)
LIMIT_PERCENT = 4.0
"""The limit that the demo states, of the range of its source's reference."""

SEED = 20201900178
"""Of the units' differences, of mounting, noise and profiles."""


@dataclass(frozen=True)
class RecordedLot:
    """A lot as the station records it: source, units, and audits that decide about them."""

    source: LabelledRecording
    units: Mapping[str, OutputRecording]
    audits: Mapping[str, LabelledRecording]


@dataclass(frozen=True)
class PressTimes:
    """How long each kind of run presses, in s."""

    source_s: float = 170.0
    unit_s: float = 25.0
    audit_s: float = 25.0


@dataclass(frozen=True)
class DemoConfig:
    """What the demo shows; an audit must last long enough to train a fair own calibration on it.
    `twin` is the nominal unit, of a diagnosis for example; None draws one.
    """

    units: int = 6
    times: PressTimes = PressTimes(source_s=300.0, unit_s=150.0, audit_s=90.0)
    batch: BatchConfig = BatchConfig()
    twin: Twin | None = None

    def __post_init__(self) -> None:
        if not 1 <= self.units <= 99:
            raise InputError(f"{self.units} units; 1 to 99 were expected")


def press_demo_lot(config: DemoConfig, folder: Path, on_run: Callable[[str], None]) -> LotFolder:
    """Press a simulated lot over its serial lines as a lot folder; one pressed before is taken.

    Raises:
        InputError: `folder` is there and is no lot folder.
        DeviceError: the simulated station failed; nothing was written.
    """
    if folder.exists():
        on_run(f"{folder}: pressed before, taken as it is; remove it to press again")
        return open_lot_folder(folder)
    serials = [f"DEMO-{k:02d}" for k in range(config.units + 1)]
    rng = np.random.default_rng(SEED)
    twins = draw_twins(rng, len(serials), twin=config.twin)
    pressed = press_simulated_lot(twins, serials, SEED, config.times, on_run)
    source = pressed.source
    lot = Lot(
        "demo",
        serials[0],
        source.unlabelled.sample_rate_Hz,
        "simulated eGaIn channel",
        limit_rmse=LimitText(LIMIT_PERCENT, is_percent=True).rmse(float(np.ptp(source.reference))),
    )
    with whole_folder(folder) as part:
        write_lot_toml(part, lot, SIMULATED)
        write_recording(part / "source" / f"{lot.source}.csv", pressed.source)
        for serial, unit in pressed.units.items():
            write_recording(part / "units" / f"{serial}.csv", unit)
            write_recording(part / "audit" / f"{serial}.csv", pressed.audits[serial])
    return open_lot_folder(folder)


def press_simulated_lot(
    twins: Sequence[Twin],
    serials: Sequence[str],
    seed: int = 0,
    times: PressTimes | None = None,
    on_run: Callable[[str], None] | None = None,
) -> RecordedLot:
    """Press every unit of a simulated lot, the source first, over the serial lines of one station.
    The seed is of mounting, noise and profiles.

    Raises:
        DeviceError: the station failed.
    """
    times, rng = times or PressTimes(), np.random.default_rng(seed)
    units: dict[str, OutputRecording] = {}
    audits: dict[str, LabelledRecording] = {}
    tell = on_run or (lambda sentence: None)
    with open_simulated_bench(twins[0], seed) as (bench, station):
        tell(f"source unit {serials[0]}: pressing with the load cell")
        source = record(bench, serials[0], source_profile(rng, times.source_s), with_reference=True)
        for twin, serial in zip(twins[1:], serials[1:], strict=True):
            station.mount(twin)
            tell(f"unit {serial}: pressing, output only")
            profile = unit_profile(rng, times.unit_s)
            units[serial] = record(bench, serial, profile, with_reference=False).output_recording()
            tell(f"unit {serial}: audit with the load cell")
            audit = record(bench, serial, unit_profile(rng, times.audit_s), with_reference=True)
            audits[serial] = audit.labelled_recording()
    return RecordedLot(source.labelled_recording(), units, audits)


def table_row(unit: UnitResult) -> list[object]:
    """Return one row of the table like the paper's Table 1, under `TABLE_HEADER`."""
    made = unit.made
    if made is None:
        return [unit.serial, unit.verdict, *[None] * 6]
    own = None if made.scores is None else made.scores.own
    ratios = [None, None] if own is None else [own.after_ratio, own.before_ratio]
    return [unit.serial, unit.verdict, made.before_rmse, made.after_rmse, made.own_rmse, *ratios, made.predicted_rmse]
