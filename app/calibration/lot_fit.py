"""The fit of a lot as an act: units that share a load are mapped by it; numbered, stored, taken back.

It is planned first, and nothing is written. A batch carries out what changes no map that rests on a lot fit already,
and no unit that a person rolled back; the rest waits for a person.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import msgspec

from softcal.app.calibration.lot_context import StoredInputs, declared_sources, lot_method, read_lot_context
from softcal.app.calibration.lot_decision import LotFitDecision, decision_in_force
from softcal.app.calibration.release import decide_lot
from softcal.app.registry.lot_recordings import source_model, target_serials, unlabelled
from softcal.app.registry.trimmed import trim_stored
from softcal.core.errors import ChangedMeanwhile
from softcal.core.maps.common_load import SPREAD, find_groups
from softcal.core.maps.config import DEFAULT
from softcal.core.maps.shared_load import LotFit, fit_lot
from softcal.core.maps.source_bias import SourceBias, compare_sources
from softcal.core.maps.synchrony import find_synchrony
from softcal.core.messages.reason import Reason, reason
from softcal.core.recording import OutputRecording
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.correspondence import BLIND, SHARED
from softcal.core.unit.lot_fit import LotMap
from softcal.core.unit.source_model import SourceModel
from softcal.core.unit.state import UnitState
from softcal.db.registry import Registry

DECIDED_BY = "lot fit"
OUTLIER_CODES = ("lot_fit.outlier", "lot_fit.noisy", "lot_fit.spread", "lot_fit.few", "lot_fit.alone")
"""Why a unit stands alone that others of the lot disagree with; the last where most share a load."""


@dataclass(frozen=True)
class LotFitPlan:
    """What a fit of a lot changes; nothing is written yet.

    Args:
        number: 1, 2, 3 ... of the fits of this lot.
        states: the changed units as they will be, by serial.
        open: those of them that a batch leaves as they are.
        alone: why other units that share a load would stand alone.
        before: revisions of the units that may take part, when it was planned.
        is_withdrawal: whether every unit gets back the map of its own.
        sources: which networks read the lot otherwise than those of its other sources.
    """

    lot_id: str
    number: int
    states: Mapping[str, UnitState]
    open: frozenset[str] = frozenset()
    alone: Mapping[str, Reason] = field(default_factory=dict)
    before: Mapping[str, int] = field(default_factory=dict)
    is_withdrawal: bool = False
    sources: tuple[Reason, ...] = ()

    def for_batch(self) -> "LotFitPlan":
        """Return the part that a batch carries out."""
        return replace(self, states={serial: one for serial, one in self.states.items() if serial not in self.open})

    @property
    def batch_messages(self) -> list[Reason]:
        """What a batch changed and what it left to a person, and who stands alone."""
        fitted_count = len(self.states) - len(self.open)
        messages = [reason("lot_fit.changes", number=self.number, count=fitted_count)] if fitted_count else []
        if self.open:
            messages.append(reason("lot_fit.open", number=self.number + bool(fitted_count), count=len(self.open)))
        return messages + self.outlier_messages

    @property
    def outlier_messages(self) -> list[Reason]:
        """Who shares a load and stands alone, and why, and which source reads the lot otherwise than the others."""
        by_reason: dict[str, list[str]] = {}
        for serial, cause in self.alone.items():
            by_reason.setdefault(str(cause), []).append(serial)
        return [
            reason("lot_fit.named", serial=", ".join(serials), why=self.alone[serials[0]])
            for serials in by_reason.values()
        ] + list(self.sources)

    def to_json(self) -> dict[str, object]:
        """Return the plan as JSON values."""
        parts = {serial: one.fit.lot_fit and vars(one.fit.lot_fit) for serial, one in self.states.items()}
        alone = {serial: str(cause) for serial, cause in self.alone.items()}
        sources = [str(cause) for cause in self.sources]
        return {"number": self.number, "units": parts, "open": sorted(self.open), "alone": alone, "sources": sources}


def plan_lot_fit(registry: Registry, lot_id: str, *, is_withdrawal: bool = False) -> LotFitPlan:
    """Return what fitting a lot together, or taking its fit back, would change; the maps are fitted, nothing is stored.

    Only units that are mapped by how their output is distributed take part: pairs and known loads say more.
    """
    in_force = decision_in_force(registry, lot_id).fit
    number = in_force.number + 1
    lot = _Lot(registry, lot_id, number)
    if is_withdrawal:
        states = {serial: lot.fitted(serial) for serial in lot.states if lot.is_fitted(serial)}
        return LotFitPlan(lot_id, number, states, before=lot.revisions, is_withdrawal=True)
    states, alone, is_open = dict[str, UnitState](), dict[str, Reason](), set[str]()
    fits = lot.fits()
    biases = compare_sources({network: fits[network].groups for network in lot.sources if network in fits}, lot.config)
    stand_alone = {serial for fit in fits.values() for serial in fit.outliers}
    unfitted = {serial for serial in lot.states if lot.is_fitted(serial)}
    for network, fit in fits.items():
        for group in fit.groups:
            together = [serial for serial in group.members if serial not in stand_alone]
            recordings = [lot.states[serial].fit.recording_sha256 for serial in together]
            maps = {
                serial: LotMap.from_group(fit.units[serial], group, recordings, number, biases.get(network))
                for serial in together
                if serial in fit.units
            }
            changed = [serial for serial, one in maps.items() if lot.is_changed(serial, one)]
            states |= {serial: lot.fitted(serial, maps[serial]) for serial in changed}
            if any(lot.is_for_person(serial) for serial in changed):
                is_open.update(changed)
        spread = {serial: one.press_spread for serial, one in fit.units.items() if one.press_spread}
        for serial, share in spread.items():
            if not lot.has_spread(serial, share):
                states[serial] = lot.fitted(serial, press_spread=share)
                is_open |= {serial} if lot.is_for_person(serial) else set()
        unfitted -= {*fit.members, *spread}
    members = {serial for fit in fits.values() for serial in fit.members}
    # Where few share a load, the others are the rule, and no outliers.
    codes = OUTLIER_CODES if 2 * len(members) > len(lot.states) else OUTLIER_CODES[:-1]
    alone |= {s: cause for fit in fits.values() for s, cause in fit.outliers.items() if cause.code in codes}
    states |= {serial: lot.fitted(serial) for serial in unfitted}
    is_open |= unfitted
    if in_force.is_withdrawn:
        is_open.update(states)
    return LotFitPlan(
        lot_id, number, states, frozenset(is_open), alone, lot.revisions, sources=lot.describe_biases(biases)
    )


def store_lot_fit(registry: Registry, plan: LotFitPlan, actor: str | None = None, reason: str = "") -> None:
    """Put the units of a plan into use, and write the decision down; nothing where the plan changes nothing.

    Raises:
        ChangedMeanwhile: somebody else fitted the lot or calibrated a unit since it was planned; nothing was changed.
    """
    if not plan.states:
        return
    with registry.transaction():
        before = decision_in_force(registry, plan.lot_id)
        conflict = None if before.fit.number + 1 == plan.number else f"lot {plan.lot_id}: somebody else fitted it"
        for serial, one in registry.pages.unit_statuses(plan.lot_id, list(plan.states), has_stale=True).items():
            if one.calibration is None or one.calibration.revision != plan.before[serial]:
                conflict = conflict or f"unit {serial} of lot {plan.lot_id}: somebody else changed it"
        if conflict:
            raise ChangedMeanwhile(f"{conflict} meanwhile; nothing was changed; fit the lot again")
        for serial, state in plan.states.items():
            with trim_stored(registry, plan.lot_id, serial, actor):
                note = f"lot fit {plan.number}"
                registry.calibrations.put_state(plan.lot_id, state, DECIDED_BY, actor=actor, reason=note)
        sittings = _sittings(registry, plan.lot_id)
        fit = LotFitDecision(plan.number, sittings, plan.alone, plan.is_withdrawal, plan.sources)
        registry.decisions.add(
            plan.lot_id, msgspec.to_builtins(replace(before, fit=fit)), action="fit", actor=actor, reason=reason
        )


def make_batch_fit(registry: Registry, lot_id: str, actor: str | None) -> LotFitPlan:
    """Carry out what a batch may of a fit of a lot; it is planned anew where somebody else was first."""
    while True:
        plan = plan_lot_fit(registry, lot_id)
        try:
            store_lot_fit(registry, plan.for_batch(), actor, "batch")
        except ChangedMeanwhile:
            continue
        return plan


def make_lot_fit(registry: Registry, plan: LotFitPlan, actor: str | None = None, reason: str = "") -> None:
    """Carry a plan out as a person's act, and decide on the lot with the maps of then."""
    with registry.transaction():
        store_lot_fit(registry, plan, actor, reason)
        decide_lot(registry, plan.lot_id, actor)


def open_lot_fit(registry: Registry, lot_id: str, recording: OutputRecording) -> Reason | None:
    """Return how many units the next fit of a lot would change for one that was pressed now; None for none.

    A unit leaves the load that it shared, and joins the one that its new recording shares.
    """
    in_force, config, count = decision_in_force(registry, lot_id).fit, lot_method(registry, lot_id).map, 0
    for sitting in in_force.sittings:
        others = [serial for serial in sitting if serial != recording.serial]
        status = registry.pages.unit_statuses(lot_id, others[:1]).get(others[0])
        if status is None or status.calibration is None:
            continue
        first = unlabelled(registry.recordings.get(status.calibration.state.fit.recording_sha256))
        joins = find_synchrony(first, recording, config).is_synchronous
        count += len(others) * (joins or recording.serial in sitting) + joins
    return reason("lot_fit.open", number=in_force.number + 1, count=count) if count else None


def _sittings(registry: Registry, lot_id: str) -> tuple[tuple[str, ...], ...]:
    by_sitting: dict[str, list[str]] = {}
    unit_statuses = registry.pages.unit_statuses(lot_id, target_serials(registry, lot_id), has_stale=True)
    for serial, status in unit_statuses.items():
        part = None if status.calibration is None else status.calibration.state.fit.lot_fit
        if part is not None:
            by_sitting.setdefault(part.sitting, []).append(serial)
    return tuple(map(tuple, by_sitting.values()))


class _Lot:
    """The units of a lot that a fit may change, and what each would be."""

    def __init__(self, registry: Registry, lot_id: str, number: int) -> None:
        self._registry, self._lot_id, self._number = registry, lot_id, number
        self._method = lot_method(registry, lot_id)
        self.config = self._method.map.shared_load
        serials = target_serials(registry, lot_id)
        unit_statuses = registry.pages.unit_statuses(lot_id, serials, has_stale=True)
        summaries = {serial: one.calibration for serial, one in unit_statuses.items() if one.calibration is not None}
        self.states = {serial: one.state for serial, one in summaries.items() if self._may_share(one.state)}
        self.revisions = {serial: summaries[serial].revision for serial in self.states}
        self._stored = StoredInputs(registry, lot_id, serials)
        released = registry.networks.released(lot_id)
        first = [] if released is None else [released.network.id]
        self.sources = list(dict.fromkeys([*first, *declared_sources(registry, lot_id)]))
        self._models: dict[str, SourceModel] = {}
        self._recordings: dict[str, OutputRecording] = {}

    def _may_share(self, state: UnitState) -> bool:
        fit = state.fit
        is_guessed = fit.correspondence.kind in (BLIND, SHARED) and not fit.correspondence.is_anchored
        return is_guessed and fit.method.id == self._method.id and self._method.map.family == DEFAULT

    def fits(self) -> dict[str, LotFit]:
        """Return the fit of the lot by each network: all units show the common load, those it reads are mapped."""
        targets, by_network = [self._recording(serial) for serial in self.states], dict[str, list[str]]()
        for serial, state in self.states.items():
            by_network.setdefault(state.fit.network_id, []).append(serial)
        if not any(find_groups(targets, self._method.map)):
            return {network: LotFit((), {}, {}) for network in by_network}
        networks = dict.fromkeys([*self.sources, *by_network]) if by_network else ()
        return {
            network: fit_lot(
                self._model(network).source,
                self._model(network).network,
                targets,
                self._method.map,
                paired=by_network.get(network, []),
            )
            for network in networks
        }

    def describe_biases(self, biases: Mapping[str, SourceBias]) -> tuple[Reason, ...]:
        """Return which sources read the lot otherwise than the others; of two it takes one to say so."""
        sources = {network: self._model(network).source for network in biases}
        messages = [bias.to_reason(sources[one].serial, sources[one].reference_unit) for one, bias in biases.items()]
        return tuple(message for message in messages if message is not None)[: None if len(biases) > 2 else 1]

    def is_changed(self, serial: str, new: LotMap) -> bool:
        fit = self.states[serial].fit
        return fit.lot_fit is None or (fit.map_sha256, fit.lot_fit) != (
            new.sha256,
            replace(new.part, number=fit.lot_fit.number),
        )

    def is_for_person(self, serial: str) -> bool:
        """Whether only a person may change it: it rests on a lot fit already, or a person rolled it back."""
        return self.is_fitted(serial) or self._registry.calibrations.was_decided_by("rollback", self._lot_id, serial)

    def is_fitted(self, serial: str) -> bool:
        """Whether a fit of the lot gave it its map, or the spread of the press in its forecast."""
        fit = self.states[serial].fit
        return fit.lot_fit is not None or any(remark.code == SPREAD for remark in fit.remarks)

    def has_spread(self, serial: str, share: float) -> bool:
        """Whether this spread of the press is in its forecast already."""
        return reason(SPREAD, share=share) in self.states[serial].fit.remarks

    def fitted(self, serial: str, lot_map: LotMap | None = None, press_spread: float = 0.0) -> UnitState:
        """Return a unit by a map of the lot fit, or by its own; its audit is scored by that map."""
        state, start_s = self.states[serial], time.perf_counter()
        networks = self.sources if state.fit.network_id in self.sources else [state.fit.network_id]
        lot, stored, models = (
            self._registry.lots.get(self._lot_id),
            self._stored,
            [self._model(one) for one in networks],
        )
        context = read_lot_context(self._registry, lot, models, None, stored.golden.get(serial, {}).values())
        problems = context.problems(self._recording(serial), stored.unit(serial))
        problem = problems[networks.index(state.fit.network_id)]
        scores = None if state.audit is None else state.audit.scores.own
        unread = str(state.unreadable_audit.values["error"]) if state.unreadable_audit else ""
        own_error = None if scores is None else scores.own
        # What is known of its audit stays: it is not trained anew.
        new = calibrate(
            replace(
                problem,
                own_calibration=own_error,
                unread_audit=unread,
                lot_map=lot_map,
                press_spread=press_spread,
                reference=state.fit.reference,
            )
        )
        seconds = (state.fit.fit_s or 0.0) + time.perf_counter() - start_s
        return replace(new, fit=replace(new.fit, fit_s=seconds), suspect_audit=state.suspect_audit)

    def _model(self, network_id: str) -> SourceModel:
        if network_id not in self._models:
            self._models[network_id] = source_model(self._registry, network_id, self._method)
        return self._models[network_id]

    def _recording(self, serial: str) -> OutputRecording:
        if serial not in self._recordings:
            sha256 = self.states[serial].fit.recording_sha256
            self._recordings[serial] = unlabelled(self._registry.recordings.get(sha256))
        return self._recordings[serial]
