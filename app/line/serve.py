"""A resident station: rig, gate and registry, served until a stop request."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from softcal.app.bootstrap import current_user
from softcal.app.line.host import Fixture, ManualFixture, StationHost
from softcal.app.line.pressed_run import RunStore
from softcal.app.line.rig import profile_for, station_reference
from softcal.app.line.station_gate import SHIFT, GateRules, StationGate
from softcal.app.logs import start_logging
from softcal.core.errors import InputError
from softcal.core.network.config import NetworkConfig
from softcal.core.orders import OrderKind, Progress
from softcal.core.profiles import Profile
from softcal.core.unit.budget import SIMULATED, Reference
from softcal.db.registry import Registry
from softcal.station.bench.bench import SIMULATED_NAME, Bench, open_bench
from softcal.station.bench.station_file import read_station_file
from softcal.station.devices.config import ForceConfig, ReadoutConfig, StageConfig, StationConfig
from softcal.station.tasks.service import Hooks, StationService

SIMULATED_RIG = StationConfig(
    StageConfig(""), ReadoutConfig(""), ForceConfig("", serial="SIM-CELL"), name=SIMULATED_NAME
)
"""What the gate of the simulated station looks at: its load cell and its safety bounds."""


@dataclass(frozen=True)
class Serving:
    """Settings of a resident station.

    Args:
        station_file: the rig; None for the simulated one.
        simulated_seed: of the simulated rig and its units; None for a real one.
        speed: simulated seconds per second.
        source_profile, unit_profile: files of profiles that replace the default ones.
        override: an engineer's reason to run in spite of the gate.
    """

    station: str
    station_file: Path | None = None
    simulated_seed: int | None = None
    speed: float = 1.0
    source_s: float | None = None
    unit_s: float | None = None
    depth_mm: float = 3.5
    profile_seed: int = 0
    source_profile: Path | None = None
    unit_profile: Path | None = None
    rules: GateRules = GateRules()
    override: str = ""
    network: NetworkConfig = NetworkConfig()

    @property
    def profiles(self) -> dict[OrderKind, Profile]:
        source = profile_for("source", self.profile_seed, self.source_s, self.depth_mm, self.source_profile)
        unit = profile_for("unit", self.profile_seed, self.unit_s, self.depth_mm, self.unit_profile)
        return {OrderKind.SOURCE: source, OrderKind.UNIT: unit, OrderKind.GOLDEN: unit}


def serve(registry: Registry, serving: Serving, spools: Path, should_run: Callable[[], bool]) -> None:
    """Own the ports of a station and perform its orders until `should_run` returns False.

    Raises:
        InputError: no station is named, its file cannot be read, or another process serves it.
    """
    fixture: Fixture
    opened: Callable[[], AbstractContextManager[Bench]]
    reference: Reference | None = SIMULATED
    if serving.simulated_seed is not None:
        from softcal.core.simulated_lot import twin_of  # noqa: PLC0415
        from softcal.station.testing.line import SimulatedLine  # noqa: PLC0415

        fixture = SimulatedLine(partial(twin_of, serving.simulated_seed), serving.simulated_seed, serving.speed)
        config, opened = SIMULATED_RIG, fixture.open
    elif serving.station_file is None:
        raise InputError("which station? give --station FILE or --simulated")
    else:
        config, fixture = read_station_file(serving.station_file), ManualFixture()
        opened, reference = partial(open_bench, config), station_reference(config)
    gate = StationGate(registry, serving.station, config, serving.rules)
    if serving.override:
        gate.override(current_user(), serving.override)
    profiles = serving.profiles
    log = start_logging(command="station serve", station=serving.station)

    def make_service(report: Callable[[Progress], None], is_stop_requested: Callable[[], bool]) -> StationService:
        return StationService(opened, profiles, spools, Hooks(report, is_stop_requested, gate))

    # A bench whose gate asks for no golden unit still has sittings.
    sitting = serving.rules.shift or SHIFT
    run_store = RunStore(registry, serving.station, serving.network, reference=reference, sitting=sitting)
    queue, write_log = registry.order_queue, lambda event, details: log.info(event, **details)
    StationHost(queue, serving.station, run_store, gate.override, make_service, fixture, write_log).run(should_run)
