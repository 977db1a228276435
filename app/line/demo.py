"""The main job on a simulated station: press, train, map, decide, register, export."""

import multiprocessing
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from softcal.app.batch.engine import EngineChoice, WorkerFailure, run_all
from softcal.app.batch.lot_work import BatchConfig
from softcal.app.files.atomic import atomic_folder
from softcal.app.files.lot_folder import LotFolder, open_lot_folder
from softcal.app.files.lot_toml import write_lot_toml
from softcal.app.files.recording_file import write_recording
from softcal.core.errors import DeviceError, InputError
from softcal.core.limit_text import LimitText
from softcal.core.lot import Lot
from softcal.core.profiles import Profile, source_profile, unit_profile
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.simulated_lot import draw_twins
from softcal.core.twin.simulate import Twin
from softcal.core.unit.budget import SIMULATED
from softcal.db.entries import UnitResult
from softcal.station.bench.bench import Bench, open_simulated_bench
from softcal.station.record.recording import StationRecording
from softcal.station.tasks.acquisition import RunProgress, record

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
    """A lot recorded by the station: source, units, and audits."""

    source: LabelledRecording
    units: Mapping[str, OutputRecording]
    audits: Mapping[str, LabelledRecording]


@dataclass(frozen=True)
class PressTimes:
    """Duration of each kind of run in s."""

    source_s: float = 170.0
    unit_s: float = 25.0
    audit_s: float = 25.0


@dataclass(frozen=True)
class DemoConfig:
    """Configuration of the demo; an audit must last long enough to train a fair own calibration.
    `twin` is the nominal unit, of a diagnosis for example; None draws one.
    """

    units: int = 6
    times: PressTimes = PressTimes(source_s=300.0, unit_s=150.0, audit_s=90.0)
    batch: BatchConfig = BatchConfig()
    twin: Twin | None = None

    def __post_init__(self) -> None:
        if not 1 <= self.units <= 99:
            raise InputError(f"{self.units} units; 1 to 99 were expected")

    @property
    def runs(self) -> int:
        """Number of presses of the station: one for the source, two for a unit."""
        return 1 + 2 * self.units


def press_demo_lot(
    config: DemoConfig,
    folder: Path,
    on_run: Callable[[str], None],
    on_share: Callable[[float], None] | None = None,
) -> LotFolder:
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
    recordings = press_simulated_lot(twins, serials, SEED, config.times, on_run, config.batch.engine, on_share)
    source = recordings.source
    lot = Lot(
        "demo",
        serials[0],
        source.unlabelled.sample_rate_Hz,
        "simulated eGaIn channel",
        limit_rmse=LimitText(LIMIT_PERCENT, is_percent=True).rmse(float(np.ptp(source.reference))),
    )
    with atomic_folder(folder) as part:
        write_lot_toml(part, lot, SIMULATED)
        write_recording(part / "source" / f"{lot.source}.csv", recordings.source)
        for serial, unit in recordings.units.items():
            write_recording(part / "units" / f"{serial}.csv", unit)
            write_recording(part / "audit" / f"{serial}.csv", recordings.audits[serial])
    return open_lot_folder(folder)


def press_simulated_lot(
    twins: Sequence[Twin],
    serials: Sequence[str],
    seed: int = 0,
    times: PressTimes | None = None,
    on_run: Callable[[str], None] | None = None,
    engine: EngineChoice | None = None,
    on_share: Callable[[float], None] | None = None,
) -> RecordedLot:
    """Press every unit of a simulated lot, the source first, each over the serial lines of its own station.
    The seed is of mounting, noise and profiles. Equal seeds give equal recordings, however many workers press.
    `on_share` is told every half a second which share is pressed, by a thread of its own.

    Raises:
        DeviceError: a station failed.
    """
    report, times = on_run or (lambda sentence: None), times or PressTimes()
    recordings: dict[str, _Recorded] = {}
    runs = [(serial, twin, seed + k) for k, (serial, twin) in enumerate(zip(serials, twins, strict=True))]
    done_s = multiprocessing.get_context("spawn").Value("d", 0.0)
    total_s = times.source_s + (len(runs) - 1) * (times.unit_s + times.audit_s)
    with _polled(lambda: (on_share or (lambda share: None))(done_s.value / total_s)):
        lot = serials[0], times, done_s
        for answer in run_all(engine or EngineChoice(), _press_source_or_unit, lot, runs):
            if isinstance(answer, WorkerFailure):
                raise DeviceError(f"unit {answer.item[0]}: the process that pressed it was ended; begin again")
            serial, recorded = answer
            recordings[serial] = recorded
            if serial == serials[0]:
                report(f"source unit {serial}: pressed with the load cell")
                continue
            report(f"unit {serial}: pressed, output only")
            report(f"unit {serial}: audited with the load cell")
    units = {serial: recordings[serial].run.output_recording() for serial in serials[1:]}
    audits = {serial: recordings[serial].labelled.labelled_recording() for serial in serials[1:]}
    return RecordedLot(recordings[serials[0]].labelled.labelled_recording(), units, audits)


@dataclass(frozen=True, eq=False)
class _Recorded:
    """Recordings of one unit: its only run, or its run without a reference and its audit."""

    run: StationRecording
    labelled: StationRecording


@contextmanager
def _polled(report: Callable[[], None]) -> Iterator[None]:
    """Report progress every half second, as worker processes report only at their end."""
    is_over = threading.Event()

    def run() -> None:
        while not is_over.wait(0.5):
            report()

    thread = threading.Thread(target=run, name="progress", daemon=True)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()


def _press_source_or_unit(lot: tuple[str, PressTimes, Any], run: tuple[str, Twin, int]) -> tuple[str, _Recorded]:
    (source, times, done_s), (serial, twin, seed) = lot, run
    rng = np.random.default_rng(seed)

    def press(bench: Bench, profile: Profile, seconds: float, with_reference: bool) -> StationRecording:
        before = 0.0

        def on_progress(progress: RunProgress) -> None:
            nonlocal before
            with done_s.get_lock():
                done_s.value += (progress.fraction - before) * seconds
            before = progress.fraction

        return record(bench, serial, profile, with_reference, on_progress)

    with open_simulated_bench(twin, seed) as (bench, _):
        if serial == source:
            recording = press(bench, source_profile(rng, times.source_s), times.source_s, True)
            return serial, _Recorded(recording, recording)
        unit = press(bench, unit_profile(rng, times.unit_s), times.unit_s, False)
        return serial, _Recorded(unit, press(bench, unit_profile(rng, times.audit_s), times.audit_s, True))


def table_row(unit: UnitResult) -> list[object]:
    """Return one row of the table like the paper's Table 1, under `TABLE_HEADER`."""
    state = unit.state
    if state is None:
        return [unit.serial, unit.verdict, *[None] * 6]
    own_scores = None if state.scores is None else state.scores.own
    ratios = [None, None] if own_scores is None else [own_scores.after_ratio, own_scores.before_ratio]
    predicted, *measured = state.errors.values()
    return [unit.serial, unit.verdict, *measured, *ratios, predicted]
