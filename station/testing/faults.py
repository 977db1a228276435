"""Faults of a station as switches of the simulated station, with their phase."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from softcal.station.bench.simulated_station import SimulatedStation
from softcal.station.simulated.far_end import FarEnd
from softcal.station.simulated.force_gauge import SimulatedIndicator, SimulatedLoadstar, SimulatedMark10
from softcal.station.simulated.zaber import SimulatedZaber
from softcal.station.tasks.durations import HOMING, PRESSING, PROBING, READING, RETURNING, SEARCHING

DOWN_S, HOLD_S, REST_S = 1.6, 3.0, 5.2
"""Seconds into the pressing of `trial.PROFILE` at which the stage goes down, holds a press, and stands between two."""

MOMENTS: Mapping[str, tuple[str, float]] = {
    "while homing": (HOMING, 0.1),
    "in the approach": (READING, 0.4),
    "in the search for contact": (SEARCHING, 0.5),
    "while feeling": (PROBING, 0.5),
    "while pressing": (PRESSING, DOWN_S),
    "in a hold": (PRESSING, HOLD_S),
    "at the zero return": (RETURNING, 0.1),
}
"""Every state a run goes through: the phase, and seconds into it."""

FaultInjection = Callable[[SimulatedStation], None]


@dataclass(frozen=True)
class Fault:
    """One fault of a station.

    Args:
        phase: phase of the run in which it happens; "" for before the run.
        after_s: seconds into that phase.
        is_detected_late: whether only a stretch of the run, or all of it, reveals the fault; others at once.
        stage_kind, force_kind: which drivers, as in a station file.
    """

    name: str
    phase: str
    after_s: float
    inject: FaultInjection
    is_detected_late: bool = False  # noqa: V107
    has_cell: bool = True
    stage_kind: str = "grbl"
    force_kind: str = "hx711"


def _at_every_moment(label: str, inject: FaultInjection, *but: str) -> list[Fault]:
    moments = {when: moment for when, moment in MOMENTS.items() if when not in but}
    return [Fault(f"{label} {when}", phase, after_s, inject) for when, (phase, after_s) in moments.items()]


def _from_the_start(name: str, inject: FaultInjection) -> Fault:
    return Fault(name, "", 0.0, inject)


def _pressing(name: str, inject: FaultInjection, after_s: float = DOWN_S, force_kind: str = "hx711") -> Fault:
    return Fault(name, PRESSING, after_s, inject, force_kind=force_kind)


def _detected_late(*faults: Fault) -> list[Fault]:
    return [replace(fault, is_detected_late=True) for fault in faults]


def _without_cell(fault: Fault) -> Fault:
    return replace(fault, name=f"{fault.name}, no load cell", has_cell=False)


def _set(target: str, name: str, value: object) -> FaultInjection:
    return lambda station: setattr(getattr(station, target), name, value)


def _add(target: str, name: str, amount: float) -> FaultInjection:
    def inject(station: SimulatedStation) -> None:
        setattr(getattr(station, target), name, getattr(getattr(station, target), name) + amount)

    return inject


def _unplug(wire: str) -> FaultInjection:
    return lambda station: getattr(station, wire).unplug()


def _force(change: Callable[[float], float]) -> FaultInjection:
    return _set("rig", "force_fault", lambda now_s, force_N: change(force_N))


def _output(change: Callable[[float], float]) -> FaultInjection:
    return _set("rig", "output_fault", lambda now_s, output_V: change(output_V))


def _stuck_noisy(now_s: float, value: float) -> float:
    """A stuck value with noise, so that no two readings are equal."""
    return 1.2 + 0.004 * math.sin(977.0 * now_s)


def hang(station: SimulatedStation, seconds: float) -> None:
    """Hold the load cell at its present force for a time, with noise."""
    since_s, rng = station.world.now_s(), np.random.default_rng(1)
    level_N: list[float] = []

    def hanging(now_s: float, force_N: float) -> float:
        level_N.append(force_N)
        return level_N[0] + float(rng.normal(0, 0.005)) if now_s < since_s + seconds else force_N

    station.rig.force_fault = hanging


def loosen(station: SimulatedStation, seconds: float, change: Callable[[float], float]) -> None:
    """The output's cable is loose for so long: the readout gets something else meanwhile."""
    since_s = station.world.now_s()
    station.rig.output_fault = lambda now_s, output_V: change(output_V) if now_s < since_s + seconds else output_V


def filter_cell(station: SimulatedStation, constant_s: float) -> None:
    """The load cell's amplifier has a first-order low pass, as every weighing indicator has."""
    newest: list[tuple[float, float]] = []  # (when, level behind the filter)

    def filtered(now_s: float, force_N: float) -> float:
        before_s, level_N = newest[-1] if newest else (now_s, force_N)
        newest[:] = [(now_s, force_N + (level_N - force_N) * math.exp((before_s - now_s) / constant_s))]
        return newest[0][1]

    station.rig.force_fault = filtered


def limit_speed(station: SimulatedStation, fastest_N_s: float) -> None:
    """The load cell's amplifier follows no faster than so, as one whose display is to be calm."""
    newest: list[tuple[float, float]] = []

    def limited(now_s: float, force_N: float) -> float:
        before_s, level_N = newest[-1] if newest else (now_s, force_N)
        step_N = fastest_N_s * (now_s - before_s)
        newest[:] = [(now_s, min(max(force_N, level_N - step_N), level_N + step_N))]
        return newest[0][1]

    station.rig.force_fault = limited


def _freeze_position(station: SimulatedStation) -> None:
    station.far_end(FarEnd, "stage").frozen_mm = station.axis.position_mm


def _floating(now_s: float, value: float) -> float:
    """An input that nothing drives: hum of the mains, far larger than any noise."""
    return 2.0 + 0.4 * math.sin(2 * math.pi * 49.0 * now_s) + 0.2 * math.sin(977.0 * now_s)


def _bit(step: float, bit: int, is_one: bool) -> Callable[[float], float]:
    """A line of a converter that is stuck."""

    def change(value: float) -> float:
        count = round(value / step)
        return step * (count | 1 << bit if is_one else count & ~(1 << bit))

    return change


def _of_stream(device: str, wire: str, end: str) -> list[Fault]:
    lines = f"every third line of the {device}"
    return [
        *_at_every_moment(f"{device} unplugged", _unplug(wire)),
        _from_the_start(f"{device} at another baud rate", _set(wire, "garbage", 1.0)),
        _pressing(f"{device} silent", _set(wire, "is_silent", True)),
        _pressing(f"noise on the {device}'s line", _set(wire, "garbage", 1.0)),
        _pressing(f"every tenth pair of the {device}'s lines in the wrong order", _set(wire, "swapped", 0.1)),
        _pressing(f"{device} at half rate", _set(end, "rate_factor", 0.5)),
        _pressing(f"{device} at double rate", _set(end, "rate_factor", 2.0)),
        _pressing(f"{device} restarts", lambda station: getattr(station, end).restart()),
        _pressing(f"{device}'s clock jumps back by 0.1 s", _add(end, "device_ms", -100.0)),
        _pressing(f"{device}'s clock jumps back by 3 s", _add(end, "device_ms", -3000.0)),
        _pressing(f"{device}'s clock jumps ahead by 0.3 s", _add(end, "device_ms", 300.0)),
        _pressing(f"{device}'s clock jumps ahead by 3 s", _add(end, "device_ms", 3000.0)),
        *_detected_late(
            _pressing(f"{lines} noise", _set(wire, "garbage", 0.3)),
            _pressing(f"{lines} torn", _set(wire, "torn", 0.3)),
            _pressing(f"{lines} with a flipped bit", _set(wire, "flipped", 0.3)),
            _pressing(f"{device} loses every tenth line", _set(wire, "loss", 0.1), 0.0),
            _pressing(f"{device} frozen", _set(end, "is_frozen", True)),
            _pressing(f"{device}'s readings become 0.6 s old", _add(wire, "delay_s", 0.6)),
        ),
    ]


def _flip_bits_unchecked(station: SimulatedStation) -> None:
    station.force.has_checksum, station.force_wire.flipped = False, 0.02


def _set_cell(kind: type[FarEnd], name: str, value: object) -> FaultInjection:
    return lambda station: setattr(station.far_end(kind, "cell"), name, value)


def _of_zaber(name: str, inject: FaultInjection) -> Fault:
    return replace(_pressing(f"{name} while pressing", inject), stage_kind="zaber")


_NOISY, _NO_UNIT = _set("rig", "output_fault", _stuck_noisy), _set("rig", "clearance_mm", 100.0)

FAULTS: tuple[Fault, ...] = (
    # Of the controller.
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
    _pressing("drive switched off while pressing", lambda s: s.axis.hold()),
    *_detected_late(
        _pressing("every third line of the controller torn", _set("stage_wire", "torn", 0.3)),
        _pressing("motor without supply while pressing", lambda s: s.rig.cut_motor()),
        _without_cell(_pressing("motor without supply", lambda s: s.rig.cut_motor())),
        _pressing("position report frozen while pressing", _freeze_position),
        _of_zaber("position report of a Zaber stage frozen", _freeze_position),
        _pressing("motor loses 0.1 mm between two presses", lambda s: s.rig.lose_steps(0.1), REST_S),
        _pressing("motor loses 0.15 mm between two presses", lambda s: s.rig.lose_steps(0.15), REST_S),
        _pressing("motor loses 0.2 mm between two presses", lambda s: s.rig.lose_steps(0.2), REST_S),
        _pressing("motor loses 0.5 mm between two presses", lambda s: s.rig.lose_steps(0.5), REST_S),
        _without_cell(_pressing("motor loses 1 mm", lambda s: s.rig.lose_steps(1.0), REST_S)),
    ),
    # Of the streams.
    *_of_stream("load cell", "force_wire", "force"),
    *_of_stream("readout", "readout_wire", "readout"),
    # Of the load cell.
    _pressing("load cell saturated", _force(lambda x: 1e6)),
    _pressing("load cell bridge breaks while pressing", _force(lambda x: 0.0)),
    _from_the_start("load cell bridge dead", _force(lambda x: 0.0)),
    _from_the_start("load cell pulls where it should press", _force(lambda x: -x)),
    _pressing("load cell zero jumps in a hold", _force(lambda x: x + 3.0), HOLD_S),
    _from_the_start("load cell not unloaded before the run", _force(lambda x: x + 3.0)),
    *_detected_late(
        *(
            _from_the_start(f"load cell's line {s:g} s late", _add("force_wire", "delay_s", s))
            for s in (0.02, 0.05, 0.1, 0.2)
        ),
        *(
            _from_the_start(f"load cell behind a low pass of {s:g} s", partial(filter_cell, constant_s=s))
            for s in (0.03, 0.06, 0.1, 0.3)
        ),
        _from_the_start("load cell follows no faster than 1.5 N/s", partial(limit_speed, fastest_N_s=1.5)),
        _pressing("load cell's gain halves between two presses", _force(lambda x: 0.5 * x), REST_S),
        _pressing("load cell's gain doubles between two presses", _force(lambda x: 2.0 * x), REST_S),
        _pressing("load cell's gain halves while pressing", _force(lambda x: 0.5 * x)),
        _pressing("load cell stuck but noisy", _set("rig", "force_fault", _stuck_noisy)),
        _pressing("load cell hangs for 1 s while pressing", lambda station: hang(station, 1.0)),
        _pressing("load cell's input floats", _set("rig", "force_fault", _floating)),
        _pressing("load cell's amplifier clips at 3 N", _force(lambda x: min(x, 3.0)), 0.0),
        _from_the_start("load cell's converter has a bit stuck", _force(_bit(1 / 9870, 13, True))),
        _pressing("load cell zero moves while pressing", _force(lambda x: x + 3.0)),
        _from_the_start("load cell's zero drifts by 0.05 N/s", _set("rig", "force_fault", lambda t, x: x + 0.05 * t)),
        _pressing("flipped bits on a load cell's line without checksums", _flip_bits_unchecked),
    ),
    # Of other devices.
    _pressing(
        "gauge set to numbers without a unit while pressing",
        _set_cell(SimulatedMark10, "is_numeric_only", True),
        force_kind="mark10",
    ),
    _pressing("gauge unplugged while pressing", _unplug("force_wire"), force_kind="mark10"),
    _pressing(
        "interface reports errors while pressing",
        _set_cell(SimulatedLoadstar, "is_faulty", True),
        force_kind="loadstar",
    ),
    _pressing(
        "indicator overloaded while pressing", _set_cell(SimulatedIndicator, "capacity_N", 0.5), force_kind="indicator"
    ),
    _of_zaber("Zaber stage stalls", lambda s: s.far_end(SimulatedZaber, "stage").stall()),
    _of_zaber("knob of a Zaber stage turned", lambda s: s.far_end(SimulatedZaber, "stage").turn_knob()),
    _of_zaber("Zaber stage unplugged", _unplug("stage_wire")),
    # Of the unit.
    _without_cell(_pressing("readout unplugged", _unplug("readout_wire"))),
    _from_the_start("unit not connected", _output(lambda x: 5.0)),
    _from_the_start("unit's wires touch from the start", _output(lambda x: 0.0)),
    _from_the_start("no unit in the fixture", _NO_UNIT),
    _from_the_start("something in the way of the approach", _set("rig", "clearance_mm", 2.6)),
    _from_the_start("hard object under the stage", lambda s: s.mount_rigid()),
    *_detected_late(
        _pressing("readout stuck but noisy", _NOISY),
        _without_cell(_pressing("readout stuck but noisy", _NOISY)),
        _pressing("readout's input floats", _set("rig", "output_fault", _floating)),
        _without_cell(_pressing("readout frozen", _set("readout", "is_frozen", True))),
        _pressing("readout's amplifier clips at 1.6 V", _output(lambda x: min(x, 1.6)), 0.0),
        _from_the_start("readout's converter has bit 5 at 0", _output(_bit(5 / 1023, 5, False))),
        _from_the_start("readout's converter has bit 6 at 1", _output(_bit(5 / 1023, 6, True))),
        *(
            _pressing(
                f"output's cable loose for {seconds:g} s {when}: {label}",
                partial(loosen, seconds=seconds, change=change),
                after_s,
            )
            for label, change in (("0 V", lambda x: 0.0), ("halved", lambda x: 0.5 * x), ("rail", lambda x: 5.0))
            for seconds, when, after_s in ((0.025, "in a hold", HOLD_S), (0.06, "while pressing", DOWN_S))
        ),
        _pressing("unit's wire breaks", _output(lambda x: 5.0)),
        _pressing("unit's wires touch", _output(lambda x: 0.0)),
        _pressing("unit falls out between two presses", _NO_UNIT, REST_S),
    ),
)
