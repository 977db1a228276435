"""A resident station: its rig, its gate and its registry, joined and served until somebody says no."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from softcal.app.station_host import StationHost
from softcal.app.workflow.station import chosen_bench, profile_for
from softcal.app.workflow.station_gate import GateRules, gate_from_registry
from softcal.core.errors import InputError
from softcal.core.orders import OrderKind
from softcal.core.station_gate import Gate, Override
from softcal.db.registry import Registry
from softcal.station.config import read_station_file
from softcal.station.service import Hooks, StationService


@dataclass(frozen=True)
class Serving:
    """What a resident station is started with.

    Args:
        station: its name, as orders call it.
        station_file, simulated_seed: which rig.
        profile_seed, depth_mm: of the profiles it presses with.
        rules: how strict its gate is.
        override: an engineer's decision to run in spite of the gate.
    """

    station: str
    station_file: Path | None
    simulated_seed: int | None
    profile_seed: int = 0
    depth_mm: float = 3.5
    rules: GateRules = GateRules()
    override: Override | None = None


def serve(registry: Registry, serving: Serving, spools: Path, goes_on: Callable[[], bool]) -> None:
    """Own the ports of a station and perform its orders until `goes_on` says no.

    Raises:
        InputError: no station is named, its file cannot be read, or another process serves it.
    """
    config = None if serving.station_file is None else read_station_file(serving.station_file)
    gate: Callable[[OrderKind], Gate] = _open_gate
    if config is not None:
        now = datetime.now(UTC)
        gate = gate_from_registry(registry, serving.station, config, now, serving.rules, serving.override)
    elif serving.simulated_seed is None:
        raise InputError("which station? give --station FILE or --simulated")
    if serving.override is not None:
        facts = {"until": serving.override.until.isoformat()}
        registry.add_event("override", "station_gate", (serving.station,), facts, reason=serving.override.reason)
    source, unit = (profile_for(kind, serving.profile_seed, None, serving.depth_mm) for kind in ("source", "unit"))
    profiles = {OrderKind.SOURCE: source, OrderKind.UNIT: unit, OrderKind.GOLDEN: unit}

    def make_service(hooks: Hooks) -> StationService:
        opened = partial(chosen_bench, serving.station_file, serving.simulated_seed)
        return StationService(opened, profiles, spools, hooks)

    StationHost(registry, serving.station, gate, make_service).run(goes_on)


def _open_gate(kind: OrderKind) -> Gate:
    """The simulated rig has no load cell that could be out of date."""
    return Gate(())
