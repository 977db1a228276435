"""Everything that can break on a station, as switches of the simulated one: what, in which phase, and how."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from softcal.station.simulated.station import SimulatedStation

SEARCH, PRESS, RETURN = "searching for contact", "pressing", "reading the zero return"
DOWN_S, HOLD_S, BETWEEN_S = 1.6, 3.0, 5.2
"""Seconds into the pressing of `trial.PROFILE` at which the stage goes down, holds a press, and stands between two."""


@dataclass(frozen=True)
class Fault:
    """One way a station can fail.

    Args:
        name: in words.
        phase: phase of the run in which it happens; "" for before the run.
        after_s: seconds into that phase.
        inject: breaks the station.
    """

    name: str
    phase: str
    after_s: float
    inject: Callable[[SimulatedStation], None]


def _unplugged() -> list[Fault]:
    faults = []
    for device, wire in (("stage", "stage_wire"), ("load cell", "force_wire"), ("readout", "readout_wire")):
        for when, phase, after_s in (
            ("in the search for contact", SEARCH, 0.5),
            ("while pressing", PRESS, DOWN_S),
            ("in a hold", PRESS, HOLD_S),
            ("at the zero return", RETURN, 0.2),
        ):

            def pull(station: SimulatedStation, wire: str = wire) -> None:
                getattr(station, wire).unplug()

            faults.append(Fault(f"{device} unplugged {when}", phase, after_s, pull))
    return faults


def _set(target: str, name: str, value: object) -> Callable[[SimulatedStation], None]:
    def inject(station: SimulatedStation) -> None:
        setattr(getattr(station, target), name, value)

    return inject


def _plus_3N(now_s: float, force_N: float) -> float:
    return force_N + 3.0


def _half(now_s: float, force_N: float) -> float:
    return 0.5 * force_N


def _stuck_noisy(now_s: float, value: float) -> float:
    """A value that hangs, with noise that goes on: no two readings are the same."""
    return 1.2 + 0.004 * math.sin(977.0 * now_s)


def _later(wire: str, seconds: float) -> Callable[[SimulatedStation], None]:
    def inject(station: SimulatedStation) -> None:
        getattr(station, wire).delay_s += seconds

    return inject


def _no_force(now_s: float, force_N: float) -> float:
    return 0.0


def _overload(now_s: float, force_N: float) -> float:
    return 1e6


def _open_circuit(now_s: float, output_V: float) -> float:
    return 5.0


FAULTS: tuple[Fault, ...] = (
    *_unplugged(),
    Fault("stage unplugged while homing", "", 0.3, lambda s: s.stage_wire.unplug()),
    Fault("homing switch missing", "", 0.0, _set("stage", "switch", "missing")),
    Fault("homing switch stuck", "", 0.0, _set("stage", "switch", "stuck")),
    Fault("controller restarts while pressing", PRESS, DOWN_S, lambda s: s.stage.dip_power()),
    Fault("controller restarts in a hold", PRESS, HOLD_S, lambda s: s.stage.dip_power()),
    Fault("hard limit switch while pressing", PRESS, DOWN_S, lambda s: s.stage.hit_limit()),
    Fault("safety door opened while pressing", PRESS, DOWN_S, lambda s: s.stage.open_door()),
    Fault("emergency stop while pressing", PRESS, DOWN_S, lambda s: s.stage.press_emergency_stop()),
    Fault("emergency stop in the search for contact", SEARCH, 0.5, lambda s: s.stage.press_emergency_stop()),
    Fault("controller silent while pressing", PRESS, DOWN_S, _set("stage_wire", "is_silent", True)),
    Fault("controller slow to answer", PRESS, DOWN_S, _set("stage", "delay_reply_s", 0.4)),
    Fault("noise on the controller's line", PRESS, DOWN_S, _set("stage_wire", "garbage", 0.5)),
    Fault("drive switched off while pressing", PRESS, DOWN_S, lambda s: s.axis.hold()),
    Fault("load cell frozen", PRESS, DOWN_S, _set("force", "is_frozen", True)),
    Fault("load cell silent", PRESS, DOWN_S, _set("force_wire", "is_silent", True)),
    Fault("load cell saturated", PRESS, DOWN_S, _set("rig", "force_fault", _overload)),
    Fault("noise on the load cell's line", PRESS, DOWN_S, _set("force_wire", "garbage", 1.0)),
    Fault("load cell at half rate", PRESS, DOWN_S, _set("force", "rate_factor", 0.5)),
    Fault("load cell restarts", PRESS, DOWN_S, lambda s: s.force.restart()),
    Fault("load cell bridge breaks while pressing", PRESS, DOWN_S, _set("rig", "force_fault", _no_force)),
    Fault("load cell zero jumps in a hold", PRESS, HOLD_S, _set("rig", "force_fault", _plus_3N)),
    Fault("load cell zero moves while pressing", PRESS, DOWN_S, _set("rig", "force_fault", _plus_3N)),
    Fault("load cell not unloaded before the run", "", 0.0, _set("rig", "force_fault", _plus_3N)),
    Fault("load cell bridge dead", "", 0.0, _set("rig", "force_fault", _no_force)),
    Fault("readout frozen", PRESS, DOWN_S, _set("readout", "is_frozen", True)),
    Fault("readout silent", PRESS, DOWN_S, _set("readout_wire", "is_silent", True)),
    Fault("noise on the readout's line", PRESS, DOWN_S, _set("readout_wire", "garbage", 1.0)),
    Fault("readout at half rate", PRESS, DOWN_S, _set("readout", "rate_factor", 0.5)),
    Fault("readout restarts", PRESS, DOWN_S, lambda s: s.readout.restart()),
    Fault("readout loses every tenth line", PRESS, 0.0, _set("readout_wire", "loss", 0.1)),
    Fault("unit's wire breaks", PRESS, DOWN_S, _set("rig", "output_fault", _open_circuit)),
    Fault("unit not connected", "", 0.0, _set("rig", "output_fault", _open_circuit)),
    Fault("no unit in the fixture", "", 0.0, _set("rig", "clearance_mm", 100.0)),
    Fault("load cell's gain halves between two presses", PRESS, BETWEEN_S, _set("rig", "force_fault", _half)),
    Fault("load cell's line 0.1 s late", "", 0.0, _later("force_wire", 0.1)),
    Fault("load cell's readings become 0.6 s old", PRESS, DOWN_S, _later("force_wire", 0.6)),
    Fault("load cell stuck but noisy", PRESS, DOWN_S, _set("rig", "force_fault", _stuck_noisy)),
    Fault("readout stuck but noisy", PRESS, DOWN_S, _set("rig", "output_fault", _stuck_noisy)),
    Fault("motor without supply while pressing", PRESS, DOWN_S, lambda s: s.rig.cut_motor()),
    Fault("hold button pressed while pressing", PRESS, DOWN_S, lambda s: s.stage.press_hold()),
    Fault("hold button pressed at the zero return", RETURN, 0.1, lambda s: s.stage.press_hold()),
    Fault("something in the way of the approach", "", 0.0, _set("rig", "clearance_mm", 2.6)),
    Fault("hard object under the stage", "", 0.0, lambda s: s.mount_rigid()),
)
