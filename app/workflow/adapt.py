"""Long-term use of one unit: estimates over a stream while its map follows the drift, every step in the registry."""

import hashlib
from collections import Counter
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from softcal.app.adaptation_chart import adaptation_figure
from softcal.app.adaptation_trace import Trace
from softcal.app.files import write_text
from softcal.app.stream_file import estimate_writer, read_stream
from softcal.core.adaptation import AdaptConfig, Adapter, MapUpdate
from softcal.core.calibration import Calibration
from softcal.core.errors import InputError
from softcal.core.estimate import Estimate
from softcal.core.health import output_limits
from softcal.core.lot import Lot
from softcal.core.maps.affine import AffineMap
from softcal.core.network import Network
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.source_model import make_source_model
from softcal.core.uncertainty import ErrorForecast
from softcal.core.verdict import Verdict
from softcal.db.registry import Registry

REASON = "the source unit itself: the shared network needs no map"


@dataclass(frozen=True, eq=False)
class UnitInUse:
    """All that following a unit needs from the registry.

    Args:
        lot: its lot.
        revision: of the calibration it starts from.
        network: the shared network f.
        calibration: f∘γ₀ and its interval.
        recording: the unit's own output at calibration.
    """

    lot: Lot
    revision: int
    network: Network
    calibration: Calibration
    recording: OutputRecording


def unit_in_use(registry: Registry, serial: str, revision: int | None = None) -> UnitInUse:
    """Return a unit as the registry knows it. The source of a lot has the identity as its map.

    Raises:
        InputError: the registry has no calibration of the serial, and it is not the source of a lot with a network.
    """
    if revision is None and not _has_calibration(registry, serial):
        _register_source(registry, serial)
    stored = registry.calibration(serial, revision)
    recording = registry.recording(stored.record.recording_sha256)
    output = recording.unlabelled if isinstance(recording, LabelledRecording) else recording
    network = registry.network(stored.record.network_id)
    calibration = Calibration.from_record(stored.record)
    return UnitInUse(registry.lot(stored.lot_id), stored.revision, network, calibration, output)


def _has_calibration(registry: Registry, serial: str) -> bool:
    return bool(registry.history(serial))


def _register_source(registry: Registry, serial: str) -> None:
    """Give the source of a lot its calibration: f itself, the identity map, the interval of f on its recording."""
    lots = [lot for lot in registry.lots() if lot.source == serial]
    sources = {entry.sha256: lot.id for lot in lots for entry in registry.recordings(lot.id, serial, "source")}
    trained = [entry for entry in registry.networks() if entry.training.get("source_recording_sha256") in sources]
    if not trained:
        return
    network = trained[-1]
    source = registry.recording(str(network.training["source_recording_sha256"]))
    if not isinstance(source, LabelledRecording):
        raise InputError(f"the source recording of {serial} has no reference; run `softcal batch` again")
    calibration = source_calibration(source, registry.network(network.id))
    record = calibration.to_record(input_sha256=network.input_sha256, recording_sha256=source.sha256)
    registry.add_calibration(sources[source.sha256], record, reason=REASON)


def source_calibration(source: LabelledRecording, network: Network) -> Calibration:
    """Return the calibration of the source unit itself."""
    model = make_source_model(source, network)
    error = model.held_out_rmse
    return Calibration(
        serial=source.serial,
        network_id=network.id,
        unit_map=AffineMap(1.0, 0.0, "identity"),
        interval=model.interval,
        output_limits=output_limits(source.unlabelled, source.unlabelled, model.interval.slope_limit > 0),
        forecast=ErrorForecast(error, error, error),
        verdict=Verdict("pass", "pass", (REASON,)),
        evidence={},
        config={},
    )


@dataclass(frozen=True)
class AdaptOptions:
    """How a stream is followed.

    Args:
        config: mode and alarm.
        revision: calibration to start from; None for the one in use.
        stream: name under which the registry keeps the course; None makes one from the file's content.
        resume: go on from the last state of the stream in the registry.
        checkpoint_s: most seconds of a live stream that a crash can lose.
    """

    config: AdaptConfig = AdaptConfig()
    revision: int | None = None
    stream: str | None = None
    resume: bool = False
    checkpoint_s: float = 60.0


@dataclass
class AdaptReport:
    """What became of a stream so far.

    Args:
        serial, revision, stream, mode: which unit, from which calibration, under which name, how.
        rows: rows taken.
        flags: rows by flag; the empty flag are the trusted ones.
        verdicts: how often the map was followed, held or jumped.
        current: the correction in force.
        trace: the course of output, estimate and predicted error, thinned.
    """

    serial: str
    revision: int
    stream: str
    mode: str
    current: MapUpdate
    rows: int = 0
    flags: Counter[str] = field(default_factory=Counter)
    verdicts: Counter[str] = field(default_factory=Counter)
    trace: Trace = field(default_factory=Trace)


class Follower:
    """Follows one stream of one unit and keeps every map and the state to resume from in the registry.

    Args:
        keeper: writes to the registry while estimates go on; None writes at once.
        is_of_content: the name of the stream comes from its content, so that a stream of this name is this one.

    Raises:
        InputError: another stream has the name, and it is not to be gone on with.
    """

    def __init__(
        self,
        registry: Registry,
        unit: UnitInUse,
        stream: str,
        options: AdaptOptions,
        keeper: Executor | None = None,
        is_of_content: bool = False,
    ) -> None:
        self._registry, self._keeper = registry, keeper
        self._writing: Future[int] | None = None
        self._adapter = Adapter(unit.network, unit.calibration, unit.recording, options.config)
        last = registry.last_adaptation(unit.calibration.serial, unit.revision, stream)
        if last is not None and not options.resume and not is_of_content:
            raise InputError(f"stream {stream!r} has begun already; go on with --resume, or give --stream another name")
        # The same stream again from its first row gives the same steps; those that are kept already stay as they are.
        self._kept_until = -1 if last is None else int(last["sample"])
        if options.resume and last is not None:
            self._adapter.restore(last["state"])
            self._adapter.reconnect()
        self._pending: list[MapUpdate] = []
        self._since_checkpoint = 0
        self._checkpoint_rows = max(1, round(options.checkpoint_s * unit.recording.sample_rate_Hz))
        serial, mode = unit.calibration.serial, options.config.mode
        self.report = AdaptReport(serial, unit.revision, stream, mode, self._adapter.current)

    def advance(self, t_s: Array, output: Array) -> Estimate:
        """Take (n,) further samples and return their rows."""
        rows = self._adapter.advance(t_s, output)
        updates = self._adapter.take_updates()
        self._pending += updates
        report = self.report
        report.rows += len(output)
        report.flags.update(rows.flag.tolist())
        report.verdicts.update(update.verdict for update in updates)
        report.current = self._adapter.current
        report.trace.add(rows, output, report.current)
        self._since_checkpoint += len(output)
        if self._since_checkpoint >= self._checkpoint_rows and self._pending:
            self.checkpoint()
        return rows

    def checkpoint(self) -> None:
        """Keep every map since the last checkpoint and the state now, in one transaction."""
        report, state = self.report, self._adapter.state()
        last = {"stream": report.stream, "sample": self._adapter.row, "event": "checkpoint", "state": state}
        entries = [*(_entry(report.stream, update) for update in self._pending), last]
        new = [entry for entry in entries if int(entry["sample"]) > self._kept_until]
        self.settle()
        if new and self._keeper is None:
            self._registry.add_adaptations(report.serial, report.revision, new)
        elif new and self._keeper is not None:
            self._writing = self._keeper.submit(self._registry.add_adaptations, report.serial, report.revision, new)
        self._pending, self._since_checkpoint = [], 0
        self._kept_until = max(self._kept_until, self._adapter.row)

    def settle(self) -> None:
        """Wait until the last checkpoint is in the registry.

        Raises:
            RegistryError: it could not be written.
        """
        if self._writing is not None:
            self._writing.result()
            self._writing = None


def _entry(stream: str, update: MapUpdate) -> dict[str, Any]:
    return {"stream": stream, "sample": update.row, "event": update.verdict, **asdict(update)}


def adapt_file(
    registry: Registry,
    serial: str,
    source: Path,
    target: Path,
    options: AdaptOptions = AdaptOptions(),  # noqa: B008 - frozen
    on_rows: Callable[[int], None] = lambda rows: None,
) -> AdaptReport:
    """Follow a recorded stream: `t_s, output` of `source` in, `t_s, estimate, lower, upper, flag` to `target`.

    A row of the result depends on no later row of `source`; `target` appears whole or not at all.

    Raises:
        InputError: `source` cannot be read, or the registry does not know the serial.
    """
    unit = unit_in_use(registry, serial, options.revision)
    stream = options.stream or _stream_of(source, options.config.mode)
    # A file that is begun again gives the same maps; its state is worth keeping at its end only.
    follower = Follower(
        registry, unit, stream, replace(options, checkpoint_s=3600.0), is_of_content=options.stream is None
    )
    with estimate_writer(target) as writer:
        for t_s, output in read_stream(source):
            writer.write(follower.advance(t_s, output))
            on_rows(follower.report.rows)
    follower.checkpoint()
    return follower.report


def _stream_of(source: Path, mode: str) -> str:
    """Return a name that the same content always has."""
    if not source.is_file():
        raise InputError(f"{source}: there is no such file")
    with source.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return f"{source.name[:40]} {digest[:16]} {mode}"


def report_json(report: AdaptReport, course: list[Mapping[str, Any]]) -> dict[str, object]:
    """Return the report as the JSON of `softcal adapt --json` (schema `softcal.adapt/1`).

    Args:
        course: the steps of the stream as the registry keeps them.
    """
    return {
        "schema": "softcal.adapt/1",
        "serial": report.serial,
        "revision": report.revision,
        "stream": report.stream,
        "mode": report.mode,
        "rows": report.rows,
        "flags": {flag: count for flag, count in sorted(report.flags.items()) if flag},
        "verdicts": dict(report.verdicts),
        "predicted_rmse": report.current.predicted_rmse,
        "alarm": report.current.alarm or None,
        "maps": [{name: value for name, value in step.items() if name != "state"} for step in maps_of(course)],
    }


def maps_of(course: list[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the steps of a course that changed the map or what is said of it, without the checkpoints."""
    return [step for step in course if step["event"] != "checkpoint"]


def write_figure(registry: Registry, path: Path, report: AdaptReport, maps: list[Mapping[str, Any]]) -> None:
    """Write drift, map, estimate and predicted error over time as one page that needs no network."""
    lot = registry.lot(registry.calibration(report.serial, report.revision).lot_id)
    title = f"{report.serial}, stream {report.stream}"
    figure = adaptation_figure(title, report.trace, maps, lot.output_unit, lot.reference_unit)
    write_text(path, figure.to_html(include_plotlyjs=True))
