"""What the registry knows that a lot's units are calibrated with, and where their results go."""

from collections.abc import Callable, Collection, Iterable, Sequence
from functools import partial
from typing import Any

from softcal.app.calibration.unit_calibration import (
    Calibrated,
    ExistingCalibration,
    LotContext,
    Refusal,
    Result,
    UnitInputs,
)
from softcal.app.registry.golden import find_golden_runs, load_day_correction
from softcal.app.registry.known_loads import known_loads
from softcal.app.registry.lot_recordings import audit_of, newest_audits
from softcal.app.registry.reference import lot_reference
from softcal.app.registry.trimmed import trim_stored
from softcal.core.errors import InputError
from softcal.core.lot import Lot
from softcal.core.maps.interface import Anchors
from softcal.core.network.config import NetworkConfig
from softcal.core.unit.day_correction import DayCorrection
from softcal.core.unit.line_spread import LineSpread
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import SourceModel
from softcal.core.unit.verdict import default_limit, stated_limit
from softcal.db.entries import NetworkEntry
from softcal.db.registry import Registry

WITH_LOT = "stated with the lot"


def declare_line_spread(registry: Registry, lot_id: str, line: LineSpread | None, actor: str | None = None) -> None:
    """Keep how differently a line presses units, where a lot folder states it anew."""
    if line is not None:
        values = {"lot_id": lot_id, **vars(line)}
        registry.declarations.declare("line_spreads", values, actor=actor, reason=WITH_LOT)


def declared_line_spread(registry: Registry, lot_id: str) -> LineSpread | None:
    """Return what was stated last for a lot; None where nothing was."""
    values = registry.declarations.newest("line_spreads", lot_id)
    return None if values is None else LineSpread(values["load"], values["day"])


def declare_sources(registry: Registry, lot_id: str, networks: Sequence[str], actor: str | None = None) -> None:
    """Keep the networks of the further sources that a lot folder names."""
    if list(networks) != declared_sources(registry, lot_id):
        listed = [{"position": k, "network_id": network} for k, network in enumerate(networks)]
        registry.declarations.declare("lot_sources", {"lot_id": lot_id, "listed": listed}, actor=actor)


def declared_sources(registry: Registry, lot_id: str) -> list[str]:
    """Return the networks of a lot's further sources, in its order."""
    values = registry.declarations.newest("lot_sources", lot_id)
    return [] if values is None else [one["network_id"] for one in values["listed"]]


def declare_family(registry: Registry, lot_id: str, family: str | None, actor: str | None = None) -> None:
    """Store the family of a lot's maps where somebody states it anew."""
    if family is not None and family != lot_method(registry, lot_id).map.family:
        values = {"lot_id": lot_id, "family": family}
        registry.declarations.declare("map_families", values, actor=actor, reason=WITH_LOT)


def lot_method(registry: Registry, lot_id: str) -> Method:
    """Return this version's method with the map family that was stated last for a lot."""
    values = registry.declarations.newest("map_families", lot_id)
    return Method() if values is None else Method.with_family(values["family"])


def config_of(network: NetworkEntry) -> NetworkConfig:
    """Return how a network was trained; the usual way where it does not say."""
    config = network.training.get("config")
    if not isinstance(config, dict):
        return NetworkConfig()
    settings: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in config.items()
    }
    try:
        return NetworkConfig(**settings)
    except TypeError:
        return NetworkConfig()


Cross = Callable[[SourceModel, str], DayCorrection | str]
"""Source, hash of a golden run → the day correction that it gives, or why it gives none."""


def read_lot_context(
    registry: Registry,
    lot: Lot,
    sources: Sequence[SourceModel],
    own_config: NetworkConfig | None = None,
    golden: Iterable[str] = (),
    day_correction: DayCorrection | None = None,
    cross: Cross | None = None,
) -> LotContext:
    """Return what a lot's units are calibrated with, as these sources see them.

    Args:
        golden: hashes of the golden runs that the registry knows their recordings to belong to.
        day_correction: the golden run that lies in the lot folder.
        cross: makes bridges; one that remembers those it made, where units come one by one.
    """
    limit = stated_limit(lot.reference_unit, lot.limit_rmse)
    if limit is None and len(sources) > 1:
        # One limit for all units, whichever source they take: a noisier source must not widen it.
        first = sources[0]
        limit = default_limit(lot.reference_unit, first.held_out_rmse, first.full_range, first.method.decision)
    line, reference = declared_line_spread(registry, lot.id), lot_reference(registry, lot.id)
    cross = cross or partial(load_day_correction, registry)
    day_corrections = {sha256: cross(sources[0], sha256) for sha256 in dict.fromkeys(golden)}
    return LotContext(tuple(sources), limit, own_config, line, reference, day_correction, day_corrections)


class StoredInputs:
    """What the registry has about units of a lot: known loads and golden runs by serial and
    recording, the newest audit by serial.
    """

    def __init__(self, registry: Registry, lot_id: str, serials: Collection[str]) -> None:
        self._registry = registry
        self.loads: dict[str, dict[str, Anchors]] = {}
        self.golden: dict[str, dict[str, str]] = {}
        for sha256, loads in known_loads(registry, lot_id, serials).items():
            self.loads.setdefault(loads.serial, {})[sha256] = loads.loads
        for sha256, (serial, golden) in find_golden_runs(registry, lot_id, serials).items():
            self.golden.setdefault(serial, {})[sha256] = golden
        only = next(iter(serials)) if len(serials) == 1 else None
        self.audits = newest_audits(registry, lot_id, only)

    @property
    def golden_runs(self) -> list[str]:
        return [sha256 for of in self.golden.values() for sha256 in of.values()]

    def unit(self, serial: str, anchors: Anchors | None = None) -> UnitInputs:
        """Return what is known of a unit; its audit is read."""
        audit = audit_of(self._registry, self.audits.get(serial))
        return UnitInputs(anchors, self.loads.get(serial, {}), self.golden.get(serial, {}), audit)


def store_result(
    registry: Registry,
    lot_id: str,
    serial: str,
    result: Result,
    by: str,
    *,
    actor: str | None = None,
    reason: str = "",
    work_sha256: str | None = None,
) -> None:
    """Put what became of a unit into use, with its trim where it was trimmed. `by` says who asks,
    batch or line; by `work_sha256`, of the files and settings it answers, it is found again.

    Raises:
        InputError: a calibration that was known is there no more, or a value cannot be stored.
    """
    if isinstance(result, Calibrated) and registry.calibrations.is_stored(
        lot_id, result.state.fit, result.input_sha256
    ):
        result = ExistingCalibration(result.input_sha256)
    if isinstance(result, Refusal):
        reasons = (result.reason,)
        registry.calibrations.refuse(lot_id, serial, str(result.verdict), reasons, actor=actor, work_sha256=work_sha256)
    elif isinstance(result, ExistingCalibration):
        if not put_back(registry, lot_id, serial, result.input_sha256, by, actor=actor, work_sha256=work_sha256):
            raise InputError(f"{serial}: its calibration vanished from the registry; run `registry verify`")
    else:
        with trim_stored(registry, lot_id, serial, actor):
            add = registry.calibrations.add
            input_hash = result.input_sha256
            add(lot_id, result.state, actor, reason, input_sha256=input_hash, decided_by=by, work_sha256=work_sha256)


def put_back(
    registry: Registry,
    lot_id: str,
    serial: str,
    input_sha256: str,
    by: str,
    *,
    actor: str | None = None,
    work_sha256: str | None = None,
) -> bool:
    """Put the calibration of an input, and the unit's trim, into use again; False without one."""
    with trim_stored(registry, lot_id, serial, actor):
        return registry.calibrations.put_in_use(lot_id, serial, input_sha256, by, actor=actor, work_sha256=work_sha256)
