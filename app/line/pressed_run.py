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
from softcal.app.line.gate_facts import SHIFT, check_golden, quarantine
from softcal.app.line.load_readings import LoadReadings, check_stated
from softcal.app.line.rig import check_labels, with_response
from softcal.app.line.scan_codes import numbered
from softcal.app.registry.golden import bridge_over, golden_lot, golden_of, newest_golden, store_golden_of
from softcal.app.registry.known_loads import store_loads
from softcal.app.registry.lot_recordings import source_model
from softcal.app.registry.reference import state_reference
from softcal.core.errors import BadReply, InputError
from softcal.core.lot import Lot, check_serial
from softcal.core.messages.reason import Reason, joined, reason
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

Tell = Callable[[Progress], None]

TRAINING, CALIBRATING = "training the shared network", "calibrating"

MOST_SOURCES = 8
"""So many sources and golden runs are kept ready: making them takes longer than a unit."""

Outcome = tuple[str, tuple[Reason, ...]]
"""Verdict of one unit, and why."""


class RunKeeper:
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
        self._source_model = lru_cache(MOST_SOURCES)(partial(source_model, registry))
        self._cross = lru_cache(MOST_SOURCES)(partial(bridge_over, registry))
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
        if order.kind is OrderKind.SOURCE and self._known_lot(order.lot_id) is None:
            Lot(order.lot_id, order.serial, 1.0)  # refuses an id that cannot be one
            return
        lot = self._registry.lots.get(order.lot_id)
        if (order.serial == lot.source) != (order.kind is OrderKind.SOURCE):
            facts = {"lot": order.lot_id, "source": lot.source, "serial": order.serial, "kind": str(order.kind)}
            raise InputError(reason("run.wrong_kind", **facts))
        if order.kind is OrderKind.UNIT:
            # Loads of a lot that could not be used are refused while nothing has moved yet.
            entry, loads = released_network(self._registry, lot.id), self._registry.lots.line_rules(lot).loads
            if entry is not None and loads:
                source = self._source(lot.id, entry.id)
                check_stated(loads, source.source, source.method.map.anchors)

    def keep(self, order: Order, recording: StationRecording | RestReading, tell: Tell) -> Progress:
        """Store a finished run with its consequences; return how the order ended.

        Raises:
            RegistryError: the registry is away; doing it again later stores nothing twice.
            InputError: the recording cannot be used.
        """
        done = Progress(order.order_id, RunState.DONE, "done", 1.0)
        if isinstance(recording, RestReading):
            return self._keep_reading(order, recording, tell, done)
        self._loads.forget()
        if order.kind is OrderKind.GOLDEN:
            return self._keep_golden(order, recording, done)
        if order.kind is OrderKind.SOURCE:
            return self._keep_source(order, recording, tell, done)
        # Several units pressed at once are numbered behind the order's serial
        channels = range(recording.output.shape[1])
        names = [order.serial] if len(channels) == 1 else [numbered(order.serial, k) for k in channels]
        units = [recording.output_recording(k, name) for k, name in zip(channels, names, strict=True)]
        loads = self._registry.lots.line_rules(self._registry.lots.get(order.lot_id)).loads
        if loads:
            if len(units) > 1:
                raise InputError(reason("load.several", count=len(units)))
            sha256 = self._store(order, units[0], recording)
            unit = self._registry.lots.get(order.lot_id).reference_unit
            return replace(done, message=(self._loads.begin(order, units[0], loads, unit),), recording_sha256=sha256)
        tell(Progress(order.order_id, RunState.RUNNING, CALIBRATING, 0.99, 1.0))
        outcomes = [self._keep_unit(order, unit, self._store(order, unit, recording)) for unit in units]
        sha256 = outcomes[0][0]
        verdicts = [verdict for _, verdict in outcomes if verdict is not None]
        if not verdicts:
            message = (reason("run.no_network", lot=order.lot_id),)
            return replace(done, message=message, recording_sha256=sha256)
        word, reasons = max(verdicts, key=lambda verdict: Verdict(verdict[0]).severity)
        return replace(done, message=reasons, recording_sha256=sha256, verdict=word)

    def _keep_reading(self, order: Order, reading: RestReading, tell: Tell, done: Progress) -> Progress:
        entry = released_network(self._registry, order.lot_id)
        model = self._source(order.lot_id, entry.id) if entry else None
        said = self._loads.take(order, reading.output[:, 0], model)
        if isinstance(said, Reason):
            return replace(done, message=(said,))
        unit, loads = said
        store_loads(
            self._registry, order.lot_id, {unit.sha256: (unit.serial, loads)}, "line", actor=order.actor or None
        )
        tell(Progress(order.order_id, RunState.RUNNING, CALIBRATING, 0.99, 1.0))
        sha256, outcome = self._keep_unit(order, unit, unit.sha256)
        word, reasons = outcome or ("", (reason("run.no_network", lot=order.lot_id),))
        return replace(done, message=reasons, recording_sha256=sha256, verdict=word)

    def _keep_golden(self, order: Order, recording: StationRecording, done: Progress) -> Progress:
        labelled = recording.labelled_recording()
        own_lot = golden_lot(self._registry, order.serial, order.lot_id)
        entry = None if own_lot is None else released_network(self._registry, own_lot)
        source = None if own_lot is None or entry is None else self._source(own_lot, entry.id)
        lot_id = own_lot or self._registry.calibrations.unit_key(order.serial, order.lot_id or None).lot_id
        sha256 = self._registry.recordings.add(
            lot_id, labelled, "audit", actor=order.actor or None, proof_method=recording.proof_method
        )
        run = check_golden(
            self._registry, self._station, labelled, order.actor, recording_sha256=sha256, source=source, lot_id=lot_id
        )
        redecide(self._registry, [lot_id], order.actor or None)
        done = replace(done, recording_sha256=sha256, verdict="pass" if run.passed else "fail")
        if run.passed:
            return replace(done, message=(Reason("golden.good"), *recording.remarks))
        held = quarantine(self._registry, self._station, run.made_at)
        facts = {"units": list(held), "golden": order.serial}
        self._registry.trail.add("quarantine", "station", (self._station,), facts, reason=joined(run.reasons))
        said = reason("golden.held", serials=", ".join(held) or Reason("golden.none"))
        return replace(done, message=(*run.reasons, said))

    def _keep_source(self, order: Order, recording: StationRecording, tell: Tell, done: Progress) -> Progress:
        def on_epoch(report: EpochReport) -> None:
            fraction = report.epoch / report.max_epochs
            facts = {"epoch": report.epoch, "most": report.max_epochs, "error": report.validation_rmse}
            message = (reason("run.epoch", **facts),)
            tell(Progress(order.order_id, RunState.RUNNING, TRAINING, fraction, message=message))

        tell(Progress(order.order_id, RunState.RUNNING, TRAINING))
        source = recording.labelled_recording()
        lot = self._known_lot(order.lot_id) or Lot(
            order.lot_id, order.serial, recording.sample_rate_Hz, output_unit=recording.output_unit
        )
        try:
            check_labels(recording, lot)
        except BadReply as error:
            raise InputError(error.reason) from error
        today, used = datetime.now(UTC).astimezone().date(), with_response(self._reference, recording)
        used = None if used is None else replace(used, used_on=today)
        actor = order.actor or None
        trained = provide_network(
            lot, source, self._registry, self._network, actor, on_epoch, proof_method=recording.proof_method
        )
        state_reference(self._registry, lot.id, used, source, order.actor or None)
        rmse = trained.metrics["validation_rmse"]
        message = (reason("run.trained", rmse=rmse, unit=lot.reference_unit), *recording.remarks)
        return replace(done, message=message, recording_sha256=source.sha256)

    def _store(self, order: Order, unit: OutputRecording, recording: StationRecording) -> str:
        """Store a recording with the method of its checks; return its hash."""
        return self._registry.recordings.add(
            order.lot_id, unit, "unit", actor=order.actor or None, proof_method=recording.proof_method
        )

    def _keep_unit(self, order: Order, unit: OutputRecording, sha256: str) -> tuple[str, Outcome | None]:
        registry, actor = self._registry, order.actor or None
        entry = released_network(registry, order.lot_id)
        if entry is None:
            return sha256, None
        lot = registry.lots.get(order.lot_id)
        golden = newest_golden(registry, self._station, lot.id, datetime.now(UTC) - self._sitting)
        if golden is not None and sha256 not in golden_of(registry, lot.id, [unit.serial]):
            store_golden_of(registry, lot.id, {sha256: (unit.serial, golden)}, actor=actor)
        kept = StoredInputs(registry, lot.id, [unit.serial])
        others = [network for network in declared_sources(registry, lot.id) if network != entry.id]
        models = [self._source(lot.id, network) for network in (entry.id, *others)]
        facts = read_lot_context(registry, lot, models, config_of(entry), kept.golden_runs, cross=self._cross)
        done = registry.calibrations.known_inputs(lot.id, [unit.serial]).get(unit.serial, ())
        made = calibrate_unit(facts, unit, kept.unit(unit.serial), done)
        why = order.reason or f"pressed on {self._station}"
        store_result(registry, lot.id, unit.serial, made, "line", actor=actor, reason=why)
        if not isinstance(made, Refusal):
            decide_unit(registry, lot.id, unit.serial, actor)
        standing = registry.pages.standings(lot.id, [unit.serial])[unit.serial]
        would = open_lot_fit(registry, lot.id, unit)
        return sha256, (standing.verdict, standing.reasons if would is None else (*standing.reasons, would))

    def _source(self, lot_id: str, network: str) -> SourceModel:
        return self._source_model(network, lot_method(self._registry, lot_id))

    def _known_lot(self, lot_id: str) -> Lot | None:
        return next((lot for lot in self._registry.lots.all() if lot.id == lot_id), None)


def released_network(registry: Registry, lot_id: str) -> NetworkEntry | None:
    """Return the released network of a lot, or None."""
    state = registry.networks.released(lot_id)
    return state.network if state else None
