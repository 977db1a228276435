"""Everything that can break on a station, as switches of the simulated one: what, in which phase, and how."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from softcal.station.devices.simulated_station import SimulatedStation
from softcal.station.simulated.force_gauge import SimulatedIndicator, SimulatedLoadstar, SimulatedMark10
from softcal.station.simulated.zaber import SimulatedZaber

HOMING, APPROACH, SEARCH = "homing", "reading the unloaded channels", "searching for contact"
FEEL, PRESS, RETURN = "feeling the unit", "pressing", "reading the zero return"
DOWN_S, HOLD_S, BETWEEN_S = 1.6, 3.0, 5.2
"""Seconds into the pressing of `trial.PROFILE` at which the stage goes down, holds a press, and stands between two."""

MOMENTS: Mapping[str, tuple[str, float]] = {
    "while homing": (HOMING, 0.1),
    "in the approach": (APPROACH, 0.4),
    "in the search for contact": (SEARCH, 0.5),
    "while feeling": (FEEL, 0.5),
    "while pressing": (PRESS, DOWN_S),
    "in a hold": (PRESS, HOLD_S),
    "at the zero return": (RETURN, 0.1),
}
"""Every state a run goes through: the phase, and seconds into it."""

Inject = Callable[[SimulatedStation], None]


@dataclass(frozen=True)
class Fault:
    """One way a station can fail.

    Args:
        phase: phase of the run in which it happens; "" for before the run.
        after_s: seconds into that phase.
        is_seen_late: whether it takes a stretch of the run, or all of it, to show this; others are seen at once.
        stage_kind, force_kind: which drivers, as in a station file.
    """

    name: str
    phase: str
    after_s: float
    inject: Inject
    is_seen_late: bool = False
    has_cell: bool = True
    stage_kind: str = "grbl"
    force_kind: str = "hx711"


def _at_every_moment(what: str, inject: Inject, *but: str) -> list[Fault]:
    moments = {when: moment for when, moment in MOMENTS.items() if when not in but}
    return [Fault(f"{what} {when}", phase, after_s, inject) for when, (phase, after_s) in moments.items()]


def _from_the_start(name: str, inject: Inject, is_seen_late: bool = False) -> Fault:
    return Fault(name, "", 0.0, inject, is_seen_late)


def _pressing(
    name: str, inject: Inject, after_s: float = DOWN_S, is_seen_late: bool = False, has_cell: bool = True
) -> Fault:
    return Fault(name, PRESS, after_s, inject, is_seen_late, has_cell)


def _set(target: str, name: str, value: object) -> Inject:
    def inject(station: SimulatedStation) -> None:
        setattr(getattr(station, target), name, value)

    return inject


def _add(target: str, name: str, amount: float) -> Inject:
    def inject(station: SimulatedStation) -> None:
        setattr(getattr(station, target), name, getattr(getattr(station, target), name) + amount)

    return inject


def _unplug(wire: str) -> Inject:
    return lambda station: getattr(station, wire).unplug()


def _force(change: Callable[[float], float]) -> Inject:
    """The load cell shows something else than the force."""
    return _set("rig", "force_fault", lambda now_s, force_N: change(force_N))


def _output(change: Callable[[float], float]) -> Inject:
    """The readout shows something else than the sensor's output."""
    return _set("rig", "output_fault", lambda now_s, output_V: change(output_V))


def _stuck_noisy(now_s: float, value: float) -> float:
    """A value that hangs, with noise that goes on: no two readings are the same."""
    return 1.2 + 0.004 * math.sin(977.0 * now_s)


def hang(station: SimulatedStation, seconds: float) -> None:
    """The load cell stays at the force of this instant for so long, and its noise goes on."""
    since_s, rng = station.world.now_s(), np.random.default_rng(1)
    level_N: list[float] = []

    def hanging(now_s: float, force_N: float) -> float:
        level_N.append(force_N)
        return level_N[0] + float(rng.normal(0, 0.005)) if now_s < since_s + seconds else force_N

    station.rig.force_fault = hanging


def _floating(now_s: float, value: float) -> float:
    """An input that nothing drives: hum of the mains, far larger than any noise."""
    return 2.0 + 0.4 * math.sin(2 * math.pi * 49.0 * now_s) + 0.2 * math.sin(977.0 * now_s)


def _bit(step: float, bit: int, is_one: bool) -> Callable[[float], float]:
    """A line of a converter that is stuck."""

    def change(value: float) -> float:
        count = round(value / step)
        return step * (count | 1 << bit if is_one else count & ~(1 << bit))

    return change


def _numeric_mark10(station: SimulatedStation) -> None:
    station.far_end(SimulatedMark10, "cell").is_numeric_only = True


def _without_checksum(inject: Inject) -> Inject:
    def both(station: SimulatedStation) -> None:
        station.force.has_checksum = False
        inject(station)

    return both


def _of_streams() -> list[Fault]:
    faults = []
    for device, wire, end in (("load cell", "force_wire", "force"), ("readout", "readout_wire", "readout")):
        faults += [
            *_at_every_moment(f"{device} unplugged", _unplug(wire)),
            _pressing(f"{device} silent", _set(wire, "is_silent", True)),
            _pressing(f"noise on the {device}'s line", _set(wire, "garbage", 1.0)),
            _from_the_start(f"{device} at another baud rate", _set(wire, "garbage", 1.0)),
            _pressing(f"every third line of the {device} noise", _set(wire, "garbage", 0.3), is_seen_late=True),
            _pressing(f"every third line of the {device} torn", _set(wire, "torn", 0.3), is_seen_late=True),
            _pressing(
                f"every third line of the {device} with a flipped bit", _set(wire, "flipped", 0.3), is_seen_late=True
            ),
            _pressing(f"every tenth pair of the {device}'s lines in the wrong order", _set(wire, "swapped", 0.1)),
            _pressing(f"{device} loses every tenth line", _set(wire, "loss", 0.1), 0.0, is_seen_late=True),
            _pressing(f"{device} frozen", _set(end, "is_frozen", True), is_seen_late=True),
            _pressing(f"{device} at half rate", _set(end, "rate_factor", 0.5)),
            _pressing(f"{device} at double rate", _set(end, "rate_factor", 2.0)),
            _pressing(f"{device} restarts", lambda station, end=end: getattr(station, end).restart()),  # type: ignore[misc]
            _pressing(f"{device}'s clock jumps back by 0.1 s", _add(end, "device_ms", -100.0)),
            _pressing(f"{device}'s clock jumps back by 3 s", _add(end, "device_ms", -3000.0)),
            _pressing(f"{device}'s clock jumps ahead by 0.3 s", _add(end, "device_ms", 300.0)),
            _pressing(f"{device}'s clock jumps ahead by 3 s", _add(end, "device_ms", 3000.0)),
            _pressing(f"{device}'s readings become 0.6 s old", _add(wire, "delay_s", 0.6), is_seen_late=True),
        ]
    return faults


def _of_controller() -> list[Fault]:
    return [
        *_at_every_moment("stage unplugged", _unplug("stage_wire")),
        *_at_every_moment("controller restarts", lambda s: s.stage.dip_power()),
        *_at_every_moment("hard limit switch", lambda s: s.stage.hit_limit(), "while homing"),
        *_at_every_moment("safety door opened", lambda s: s.stage.open_door()),
        *_at_every_moment("emergency stop", lambda s: s.stage.press_emergency_stop()),
        *_at_every_moment("hold button pressed", lambda s: s.stage.press_hold(), "while homing"),
        *_at_every_moment("controller silent", _set("stage_wire", "is_silent", True)),
        _from_the_start("homing switch missing", _set("stage", "switch", "missing")),
        _from_the_start("homing switch stuck", _set("stage", "switch", "stuck")),
        _pressing("controller slow to answer", _set("stage", "delay_reply_s", 0.4)),
        _pressing("noise on the controller's line", _set("stage_wire", "garbage", 0.5)),
        _pressing("every third line of the controller torn", _set("stage_wire", "torn", 0.3), is_seen_late=True),
        _pressing("drive switched off while pressing", lambda s: s.axis.hold()),
        _pressing("motor without supply while pressing", lambda s: s.rig.cut_motor(), is_seen_late=True),
        _pressing("motor without supply, no load cell", lambda s: s.rig.cut_motor(), is_seen_late=True, has_cell=False),
        _pressing(
            "motor loses 0.5 mm between two presses", lambda s: s.rig.lose_steps(0.5), BETWEEN_S, is_seen_late=True
        ),
        _pressing(
            "motor loses 1 mm, no load cell",
            lambda s: s.rig.lose_steps(1.0),
            BETWEEN_S,
            is_seen_late=True,
            has_cell=False,
        ),
    ]


def _of_cell() -> list[Fault]:
    late = (0.02, 0.05, 0.1, 0.2)
    return [
        *(
            _from_the_start(f"load cell's line {s:g} s late", _add("force_wire", "delay_s", s), is_seen_late=True)
            for s in late
        ),
        _pressing(
            "load cell's gain halves between two presses", _force(lambda x: 0.5 * x), BETWEEN_S, is_seen_late=True
        ),
        _pressing(
            "load cell's gain doubles between two presses", _force(lambda x: 2.0 * x), BETWEEN_S, is_seen_late=True
        ),
        _pressing("load cell's gain halves while pressing", _force(lambda x: 0.5 * x), is_seen_late=True),
        _pressing("load cell stuck but noisy", _set("rig", "force_fault", _stuck_noisy), is_seen_late=True),
        _pressing("load cell hangs for 1 s while pressing", lambda station: hang(station, 1.0), is_seen_late=True),
        _pressing("load cell's input floats", _set("rig", "force_fault", _floating), is_seen_late=True),
        _pressing("load cell saturated", _force(lambda x: 1e6)),
        _pressing("load cell's amplifier clips at 3 N", _force(lambda x: min(x, 3.0)), 0.0, is_seen_late=True),
        _from_the_start("load cell's converter has a bit stuck", _force(_bit(1 / 9870, 13, True)), is_seen_late=True),
        _pressing("load cell bridge breaks while pressing", _force(lambda x: 0.0)),
        _from_the_start("load cell bridge dead", _force(lambda x: 0.0)),
        _from_the_start("load cell pulls where it should press", _force(lambda x: -x)),
        _pressing("load cell zero jumps in a hold", _force(lambda x: x + 3.0), HOLD_S),
        _pressing("load cell zero moves while pressing", _force(lambda x: x + 3.0), is_seen_late=True),
        _from_the_start("load cell not unloaded before the run", _force(lambda x: x + 3.0)),
        _from_the_start(
            "load cell's zero drifts by 0.05 N/s",
            _set("rig", "force_fault", lambda t, x: x + 0.05 * t),
            is_seen_late=True,
        ),
        _pressing(
            "flipped bits on a load cell's line without checksums",
            _without_checksum(_set("force_wire", "flipped", 0.02)),
            is_seen_late=True,
        ),
        Fault(
            "gauge set to numbers without a unit while pressing", PRESS, DOWN_S, _numeric_mark10, force_kind="mark10"
        ),
        Fault("gauge unplugged while pressing", PRESS, DOWN_S, _unplug("force_wire"), force_kind="mark10"),
        Fault(
            "interface reports errors while pressing",
            PRESS,
            DOWN_S,
            lambda s: setattr(s.far_end(SimulatedLoadstar, "cell"), "is_faulty", True),
            force_kind="loadstar",
        ),
        Fault(
            "indicator overloaded while pressing",
            PRESS,
            DOWN_S,
            lambda s: setattr(s.far_end(SimulatedIndicator, "cell"), "capacity_N", 0.5),
            force_kind="indicator",
        ),
        Fault(
            "Zaber stage stalls while pressing",
            PRESS,
            DOWN_S,
            lambda s: s.far_end(SimulatedZaber, "stage").stall(),
            stage_kind="zaber",
        ),
        Fault(
            "knob of a Zaber stage turned while pressing",
            PRESS,
            DOWN_S,
            lambda s: s.far_end(SimulatedZaber, "stage").turn_knob(),
            stage_kind="zaber",
        ),
        Fault("Zaber stage unplugged while pressing", PRESS, DOWN_S, _unplug("stage_wire"), stage_kind="zaber"),
    ]


def _of_unit() -> list[Fault]:
    return [
        _pressing("readout stuck but noisy", _set("rig", "output_fault", _stuck_noisy), is_seen_late=True),
        _pressing(
            "readout stuck but noisy, no load cell",
            _set("rig", "output_fault", _stuck_noisy),
            is_seen_late=True,
            has_cell=False,
        ),
        _pressing("readout's input floats", _set("rig", "output_fault", _floating), is_seen_late=True),
        _pressing(
            "readout frozen, no load cell", _set("readout", "is_frozen", True), is_seen_late=True, has_cell=False
        ),
        _pressing("readout unplugged, no load cell", _unplug("readout_wire"), has_cell=False),
        _pressing("readout's amplifier clips at 1.6 V", _output(lambda x: min(x, 1.6)), 0.0, is_seen_late=True),
        _from_the_start("readout's converter has bit 5 at 0", _output(_bit(5 / 1023, 5, False)), is_seen_late=True),
        _from_the_start("readout's converter has bit 6 at 1", _output(_bit(5 / 1023, 6, True)), is_seen_late=True),
        _pressing("unit's wire breaks", _output(lambda x: 5.0), is_seen_late=True),
        _pressing("unit's wires touch", _output(lambda x: 0.0), is_seen_late=True),
        _from_the_start("unit not connected", _output(lambda x: 5.0)),
        _from_the_start("unit's wires touch from the start", _output(lambda x: 0.0)),
        _from_the_start("no unit in the fixture", _set("rig", "clearance_mm", 100.0)),
        _pressing(
            "unit falls out between two presses", _set("rig", "clearance_mm", 100.0), BETWEEN_S, is_seen_late=True
        ),
        _from_the_start("something in the way of the approach", _set("rig", "clearance_mm", 2.6)),
        _from_the_start("hard object under the stage", lambda s: s.mount_rigid()),
    ]


FAULTS: tuple[Fault, ...] = (*_of_controller(), *_of_streams(), *_of_cell(), *_of_unit())
