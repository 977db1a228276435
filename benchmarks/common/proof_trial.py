"""Good rigs of many kinds, drawn at random, each pressed by the real code: none of their recordings may be refused."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from common.rig_trial import ForceLaw, LawUnit

from softcal.core.profiles import Profile, ramps, source_profile, unit_profile
from softcal.core.twin.parameters import BaseParameters
from softcal.core.twin.simulate import EffectSetting, Twin, TwinStream
from softcal.station.bench.bench import Bench, open_bench, simulated_config
from softcal.station.bench.simulated_station import SimulatedStation
from softcal.station.devices.config import UNKNOWN_S
from softcal.station.record.recording import StationRecording
from softcal.station.record.spool import Spool
from softcal.station.simulated.rig import Physics
from softcal.station.tasks.acquisition import RunProgress, record

CELL_HZ = (10.0, 20.0, 80.0)
"""Rates of the load cells that are drawn: both of an HX711, and a rate between."""


@dataclass(frozen=True)
class GoodRig:
    """One rig with which nothing is wrong.

    Args:
        seed: of everything that is drawn.
        unit: what lies under the stage, in words.
        cell_Hz: rate of the load cell.
        jitter_s: mean random delay of its line.
        late_s: how late its readings are.
        latency_s: what the station file says of that; −1 for nothing.
        profile: what is pressed.
        make_unit: (rng) -> the unit.
        stage_kind: driver of its stage.
    """

    seed: int
    unit: str
    cell_Hz: float
    jitter_s: float
    late_s: float
    latency_s: float
    profile: Profile
    make_unit: Callable[[np.random.Generator], Physics]
    stage_kind: str = "grbl"


def draw_good_rig(seed: int) -> GoodRig:
    """Draw a rig: force law, hysteresis, relaxation, softening, noise, rate and delays of the cell, and the profile."""
    rng = np.random.default_rng([seed, 18])
    is_law = bool(rng.random() < 0.3)
    unit, make_unit = _draw_law(rng) if is_law else _draw_twin(rng)
    cell_Hz = float(rng.choice(CELL_HZ, p=(0.15, 0.15, 0.7)))
    late_s = float(rng.uniform(0.02, 0.3)) if rng.random() < 0.4 else 0.0
    latency_s = UNKNOWN_S if late_s and rng.random() < 0.5 else late_s
    jitter_s = float(rng.choice([0.002, 0.005, 0.01]))
    return GoodRig(seed, unit, cell_Hz, jitter_s, late_s, latency_s, _draw_profile(rng), make_unit)


@contextmanager
def open_good_rig(rig: GoodRig) -> Iterator[tuple[Bench, SimulatedStation]]:
    """Open the bench of a drawn rig, and its far ends."""
    rng = np.random.default_rng([rig.seed, 19])
    station = SimulatedStation(Twin(), rng, stage_kind=rig.stage_kind)
    station.rig.mount([rig.make_unit(rng)], station.free_mm + 1.0 + rng.uniform(-0.2, 0.2), 0.0)
    station.force.rate_Hz, station.force_wire.jitter_s = rig.cell_Hz, rig.jitter_s
    station.force_wire.delay_s += rig.late_s
    plain = simulated_config(station)
    cell = replace(plain.force, rate_Hz=rig.cell_Hz, latency_s=rig.latency_s)  # type: ignore[type-var]
    silence_s = max(plain.safety.silence_s, min(1.0, 4.0 / rig.cell_Hz))
    config = replace(plain, force=cell, safety=replace(plain.safety, silence_s=silence_s))
    try:
        with open_bench(config, station.world) as bench:
            yield bench, station
    finally:
        station.close()


def press_good_rig(
    rig: GoodRig,
    spool: Path | None = None,
    on_progress: Callable[[RunProgress, SimulatedStation], None] = lambda progress, station: None,
) -> StationRecording:
    """Press a drawn rig.

    Args:
        spool: file that takes everything that is read.
        on_progress: called about every 0.1 s; it may break the station.

    Raises:
        DeviceError: the run was refused; on a rig that nobody broke this is a false alarm.
    """
    with open_good_rig(rig) as (bench, station):

        def press(spool: Spool | None) -> StationRecording:
            return record(bench, "P1", rig.profile, True, lambda progress: on_progress(progress, station), spool)

        if spool is None:
            return press(None)
        with Spool(spool, {"serial": "P1"}) as run_spool:
            return press(run_spool)


def _draw_law(rng: np.random.Generator) -> tuple[str, Callable[[np.random.Generator], Physics]]:
    power, at_3mm_N = float(rng.uniform(1.0, 2.0)), float(rng.uniform(2.0, 8.0))
    noise_N, noise_V = float(rng.uniform(0.002, 0.02)), float(rng.uniform(0.001, 0.005))
    law = ForceLaw(at_3mm_N / 3.0**power, power)
    return f"{law.coefficient:.2f}·x^{power:.2f} N", lambda own: LawUnit(law, own, noise_N, noise_V)


def _draw_twin(rng: np.random.Generator) -> tuple[str, Callable[[np.random.Generator], Physics]]:
    base = BaseParameters(
        k1_N_mm=float(rng.uniform(0.4, 1.4)),
        k3_N_mm3=float(rng.uniform(0.02, 0.14)),
        kappa_per_N=float(rng.uniform(0.04, 0.08)),
        sigma_output_V=float(rng.uniform(0.0005, 0.004)),
        sigma_force_N=float(rng.uniform(0.004, 0.02)),
    )
    menu = {
        "stress_relaxation": {"g": float(rng.uniform(0.05, 0.4)), "tau": float(10 ** rng.uniform(-1.2, 1.5))},
        "mechanical_hysteresis": {"a": float(rng.uniform(0.02, 0.25))},
        "mullins_softening": {"m": float(rng.uniform(0.05, 0.25))},
        "misaligned_contact": {"l": float(rng.uniform(0.1, 0.5))},
        "frame_compliance": {"c_f": float(rng.uniform(0.005, 0.05))},
        "channel_creep": {"c": float(rng.uniform(0.02, 0.3))},
        "readout_lag": {"tau": float(10 ** rng.uniform(-2, -0.5))},
    }
    chosen = [name for name in menu if rng.random() < 0.35]
    effects = tuple(EffectSetting(name, menu[name]) for name in chosen)
    return " + ".join(["base", *chosen]), lambda own: TwinStream(Twin(base, effects), own)


def _draw_profile(rng: np.random.Generator) -> Profile:
    depth_mm = float(rng.uniform(1.5, 3.5))
    kind = rng.choice(["unit", "source", "ramps"])
    if kind == "unit":
        return unit_profile(rng, 25.0, depth_mm)
    if kind == "source":
        return source_profile(rng, 40.0, depth_mm)
    return ramps([depth_mm] * 4, float(rng.uniform(1.0, 8.0)), rest_s=0.5)
