"""Results of a run: a recording, and a trained network, a verdict or a golden check.

If the lot requires known loads, the verdict of a unit follows their readings.
"""

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import lru_cache, partial

from softcal.app.batch.train import provide_network
from softcal.app.calibration.lot_context import (
    StoredInputs,
    config_of,
    declared_sources,
    lot_method,
    read_lot_context,
    store_result,
)
from softcal.app.calibration.lot_fit import open_lot_fit
from softcal.app.calibration.redecision import redecide
from softcal.app.calibration.release import decide_unit
from softcal.app.calibration.unit_calibration import Refusal, calibrate_unit
from softcal.app.line.load_readings import LoadReadings, check_declared_loads
from softcal.app.line.rig import check_labels, with_response
from softcal.app.line.scan_codes import channel_serial
from softcal.app.line.station_gate import SHIFT, check_golden, quarantine
from softcal.app.registry.golden import (
    find_golden_runs,
    golden_lot,
    load_day_correction,
    newest_golden,
    store_golden_runs,
)
from softcal.app.registry.known_loads import store_loads
from softcal.app.registry.lot_recordings import source_model
from softcal.app.registry.reference import declare_reference
from softcal.core.errors import BadReply, InputError
from softcal.core.lot import Lot, check_serial
from softcal.core.messages.reason import Reason, reason, to_line
from softcal.core.network.config import EpochReport, NetworkConfig
from softcal.core.orders import Order, OrderKind, Progress, RunState
from softcal.core.recording import OutputRecording
from softcal.core.unit.budget import Reference
from softcal.core.unit.source_model import SourceModel
from softcal.core.unit.verdict import Verdict
from softcal.db.entries import NetworkEntry
from softcal.db.registry import Registry
from softcal.station.record.recording import StationRecording
from softcal.station.tasks.at_rest import RestReading

PublishProgress = Callable[[Progress], None]

TRAINING, CALIBRATING = "training the shared network", "calibrating"

MAX_SOURCES = 8
"""So many sources and golden runs are kept ready: making them takes longer than a unit."""

Outcome = tuple[str, tuple[Reason, ...]]
"""Verdict of one unit, and why."""


class RunStore:
    """Stores finished runs of one station in the registry and calibrates the pressed units.

    Args:
        reference: what the station compares sources with; None where nobody said.
        sitting: how long after a golden run of the source units are fitted to it.
    """

    def __init__(
        self,
        registry: Registry,
        station: str,
        network: NetworkConfig = NetworkConfig(),  # noqa: B008 - frozen
        reference: Reference | None = None,
        sitting: timedelta = SHIFT,
    ) -> None:
        self._registry, self._station, self._reference = registry, station, reference
        self._network, self._sitting = network, sitting
        self._source_model = lru_cache(MAX_SOURCES)(partial(source_model, registry))
        self._day_correction = lru_cache(MAX_SOURCES)(partial(load_day_correction, registry))
        self._loads = LoadReadings()

    def check(self, order: Order) -> None:
        """Refuse an order whose run could not be stored, before any motion."""
        if order.kind is OrderKind.LOAD:
            self._loads.check(order)
            return
        if not order.kind.presses:
            return
        check_serial(order.serial)
        if order.kind is OrderKind.GOLDEN:
            if golden_lot(self._registry, order.serial, order.lot_id) is None:
                self._registry.calibrations.get(order.serial, lot_id=order.lot_id or None)
            return
        if not order.lot_id:
            raise InputError(reason("run.no_lot", serial=order.serial))
        if order.kind is OrderKind.SOURCE and self._find_lot(order.lot_id) is None:
            Lot(order.lot_id, order.serial, 1.0)  # refuses an id that cannot be one
            return
        lot = self._registry.lots.get(order.lot_id)
        if (order.serial == lot.source) != (order.kind is OrderKind.SOURCE):
            details = {"lot": order.lot_id, "source": lot.source, "serial": order.serial, "kind": str(order.kind)}
            raise InputError(reason("run.wrong_kind", **details))
        if order.kind is OrderKind.UNIT:
            # Loads of a lot that could not be used are refused while nothing has moved yet.
            entry, loads = released_network(self._registry, lot.id), self._registry.lots.line_rules(lot).loads
            if entry is not None and loads:
                source = self._source(lot.id, entry.id)
                check_declared_loads(loads, source.source, source.method.map.anchors)

    def store(self, order: Order, recording: StationRecording | RestReading, publish: PublishProgress) -> Progress:
        """Store a finished run with its consequences; return how the order ended.

        Raises:
            RegistryError: the registry is away; doing it again later stores nothing twice.
            InputError: the recording cannot be used.
        """
        final_progress = Progress(order.order_id, RunState.DONE, "done", 1.0)
        if isinstance(recording, RestReading):
            return self._store_reading(order, recording, publish, final_progress)
        self._loads.forget()
        if order.kind is OrderKind.GOLDEN:
            return self._store_golden(order, recording, final_progress)
        if order.kind is OrderKind.SOURCE:
            return self._store_source(order, recording, publish, final_progress)
        # Several units pressed at once are numbered behind the order's serial
        channels = range(recording.output.shape[1])
        names = [order.serial] if len(channels) == 1 else [channel_serial(order.serial, k) for k in channels]
        units = [recording.output_recording(k, name) for k, name in zip(channels, names, strict=True)]
        loads = self._registry.lots.line_rules(self._registry.lots.get(order.lot_id)).loads
        if loads:
            if len(units) > 1:
                raise InputError(reason("load.several", count=len(units)))
            sha256 = self._store_recording(order, units[0], recording)
            unit = self._registry.lots.get(order.lot_id).reference_unit
            return replace(
                final_progress, message=(self._loads.begin(order, units[0], loads, unit),), recording_sha256=sha256
            )
        publish(Progress(order.order_id, RunState.RUNNING, CALIBRATING, 0.99, 1.0))
        outcomes = [self._store_unit(order, unit, self._store_recording(order, unit, recording)) for unit in units]
        sha256 = outcomes[0][0]
        verdicts = [verdict for _, verdict in outcomes if verdict is not None]
        if not verdicts:
            message = (reason("run.no_network", lot=order.lot_id),)
            return replace(final_progress, message=message, recording_sha256=sha256)
        word, reasons = max(verdicts, key=lambda verdict: Verdict(verdict[0]).severity)
        return replace(final_progress, message=reasons, recording_sha256=sha256, verdict=word)

    def _store_reading(
        self, order: Order, reading: RestReading, publish: PublishProgress, final_progress: Progress
    ) -> Progress:
        entry = released_network(self._registry, order.lot_id)
        model = self._source(order.lot_id, entry.id) if entry else None
        answer = self._loads.take(order, reading.output[:, 0], model)
        if isinstance(answer, Reason):
            return replace(final_progress, message=(answer,))
        unit, loads = answer
        store_loads(
            self._registry, order.lot_id, {unit.sha256: (unit.serial, loads)}, "line", actor=order.actor or None
        )
        publish(Progress(order.order_id, RunState.RUNNING, CALIBRATING, 0.99, 1.0))
        sha256, outcome = self._store_unit(order, unit, unit.sha256)
        word, reasons = outcome or ("", (reason("run.no_network", lot=order.lot_id),))
        return replace(final_progress, message=reasons, recording_sha256=sha256, verdict=word)

    def _store_golden(self, order: Order, recording: StationRecording, final_progress: Progress) -> Progress:
        labelled = recording.labelled_recording()
        source_lot = golden_lot(self._registry, order.serial, order.lot_id)
        entry = None if source_lot is None else released_network(self._registry, source_lot)
        source = None if source_lot is None or entry is None else self._source(source_lot, entry.id)
        lot_id = source_lot or self._registry.calibrations.unit_key(order.serial, order.lot_id or None).lot_id
        sha256 = self._registry.recordings.add(
            lot_id, labelled, "audit", actor=order.actor or None, proof_method=recording.proof_method
        )
        run = check_golden(
            self._registry, self._station, labelled, order.actor, recording_sha256=sha256, source=source, lot_id=lot_id
        )
        redecide(self._registry, [lot_id], order.actor or None)
        final_progress = replace(final_progress, recording_sha256=sha256, verdict="pass" if run.passed else "fail")
        if run.passed:
            return replace(final_progress, message=(Reason("golden.good"), *recording.remarks))
        quarantined = quarantine(self._registry, self._station, run.made_at)
        details = {"units": list(quarantined), "golden": order.serial}
        self._registry.trail.add("quarantine", "station", (self._station,), details, reason=to_line(run.reasons))
        message = reason("golden.held", serials=", ".join(quarantined) or Reason("golden.none"))
        return replace(final_progress, message=(*run.reasons, message))

    def _store_source(
        self, order: Order, recording: StationRecording, publish: PublishProgress, final_progress: Progress
    ) -> Progress:
        def on_epoch(report: EpochReport) -> None:
            fraction = report.epoch / report.max_epochs
            values = {"epoch": report.epoch, "most": report.max_epochs, "error": report.validation_rmse}
            message = (reason("run.epoch", **values),)
            publish(Progress(order.order_id, RunState.RUNNING, TRAINING, fraction, message=message))

        publish(Progress(order.order_id, RunState.RUNNING, TRAINING))
        source = recording.labelled_recording()
        lot = self._find_lot(order.lot_id) or Lot(
            order.lot_id, order.serial, recording.sample_rate_Hz, output_unit=recording.output_unit
        )
        try:
            check_labels(recording, lot)
        except BadReply as error:
            raise InputError(error.reason) from error
        today, reference = datetime.now(UTC).astimezone().date(), with_response(self._reference, recording)
        reference = None if reference is None else replace(reference, used_on=today)
        actor = order.actor or None
        trained = provide_network(
            lot, source, self._registry, self._network, actor, on_epoch, proof_method=recording.proof_method
        )
        declare_reference(self._registry, lot.id, reference, source, order.actor or None)
        rmse = trained.metrics["validation_rmse"]
        message = (reason("run.trained", rmse=rmse, unit=lot.reference_unit), *recording.remarks)
        return replace(final_progress, message=message, recording_sha256=source.sha256)

    def _store_recording(self, order: Order, unit: OutputRecording, recording: StationRecording) -> str:
        """Store a recording with the method of its checks; return its hash."""
        return self._registry.recordings.add(
            order.lot_id, unit, "unit", actor=order.actor or None, proof_method=recording.proof_method
        )

    def _store_unit(self, order: Order, unit: OutputRecording, sha256: str) -> tuple[str, Outcome | None]:
        registry, actor = self._registry, order.actor or None
        entry = released_network(registry, order.lot_id)
        if entry is None:
            return sha256, None
        lot = registry.lots.get(order.lot_id)
        golden = newest_golden(registry, self._station, lot.id, datetime.now(UTC) - self._sitting)
        if golden is not None and sha256 not in find_golden_runs(registry, lot.id, [unit.serial]):
            store_golden_runs(registry, lot.id, {sha256: (unit.serial, golden)}, actor=actor)
        inputs = StoredInputs(registry, lot.id, [unit.serial])
        others = [network for network in declared_sources(registry, lot.id) if network != entry.id]
        models = [self._source(lot.id, network) for network in (entry.id, *others)]
        context = read_lot_context(
            registry, lot, models, config_of(entry), inputs.golden_runs, cross=self._day_correction
        )
        stored_inputs = registry.calibrations.stored_inputs(lot.id, [unit.serial]).get(unit.serial, ())
        result = calibrate_unit(context, unit, inputs.unit(unit.serial), stored_inputs)
        cause = order.reason or f"pressed on {self._station}"
        store_result(registry, lot.id, unit.serial, result, "line", actor=actor, reason=cause)
        if not isinstance(result, Refusal):
            decide_unit(registry, lot.id, unit.serial, actor)
        status = registry.pages.unit_statuses(lot.id, [unit.serial])[unit.serial]
        open_reason = open_lot_fit(registry, lot.id, unit)
        return sha256, (status.verdict, status.reasons if open_reason is None else (*status.reasons, open_reason))

    def _source(self, lot_id: str, network: str) -> SourceModel:
        return self._source_model(network, lot_method(self._registry, lot_id))

    def _find_lot(self, lot_id: str) -> Lot | None:
        return next((lot for lot in self._registry.lots.all() if lot.id == lot_id), None)


def released_network(registry: Registry, lot_id: str) -> NetworkEntry | None:
    """Return the released network of a lot, or None."""
    state = registry.networks.released(lot_id)
    return state.network if state else None
