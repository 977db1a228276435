"""Checks of a stage: motion to a target, position reports, refusals, and a stop in every state."""

from collections.abc import Callable

import numpy as np

from softcal.core.errors import CommandRefused, DeviceError
from softcal.station.interfaces import Move, Stage
from softcal.station.testing.rig import DriverRig, require

POSITION_MM = 0.02
POLL_S = 0.03
"""How far off its time a position may be."""

STOP_S = 0.5
DETECTION_S = 1.0
TARGETS_MM = (5.0, 12.5, 12.5, 3.0, 3.2)


class _BrokenOffError(Exception):
    """A stop was requested while the stage was homing."""


def _speed_mm_s(stage: Stage) -> float:
    return min(8.0, stage.max_speed_mm_s)


def _braking_s(stage: Stage) -> float:
    return _speed_mm_s(stage) / stage.acceleration_mm_s2


def _go(rig: DriverRig, stage: Stage, to_mm: float) -> None:
    stage.begin(Move(to_mm, _speed_mm_s(stage)))
    rig.poll_stage(stage, abs(to_mm - rig.position_mm()) / _speed_mm_s(stage) + 4.0, lambda: not stage.is_moving)
    require(not stage.is_moving, f"a move to {to_mm:g} mm does not end")


def _moves_only_when_homed(rig: DriverRig) -> None:
    stage: Stage = rig.open()
    before_mm = rig.position_mm()
    require(not stage.is_position_known, "is_position_known before it was homed")
    _expect_refusal(stage, Move(5.0, 1.0), "before it is homed")
    rig.fault_within(0.5, stage.poll)  # A controller that is locked until it is homed may say so.
    require(rig.position_mm() == before_mm, "it moved without being told to")


def _expect_refusal(stage: Stage, move: Move, when: str) -> None:
    try:
        stage.begin(move)
    except CommandRefused:
        return
    require(
        False, f"{when} it took a move to {move.to_mm:g} mm at {move.speed_mm_s:g} mm/s; `CommandRefused` was expected"
    )


def _homes(rig: DriverRig) -> None:
    stage: Stage = rig.open()
    waits: list[None] = []
    stage.home(lambda: waits.append(None))
    require(stage.is_position_known and not stage.is_moving, "after home() its position must be known and it must rest")
    off_mm = abs(stage.position_mm - rig.position_mm())
    require(
        off_mm <= POSITION_MM, f"after home() it says {stage.position_mm:.3f} mm, {rig.position_mm():.3f} mm is true"
    )
    require(waits, "home() never called on_wait: nobody could break it off")


def _check_targets(rig: DriverRig) -> None:
    stage = rig.homed()
    for to_mm in TARGETS_MM:
        _go(rig, stage, to_mm)
        for verb, at_mm in (("is", rig.position_mm()), ("says it is", stage.position_mm)):
            require(abs(at_mm - to_mm) <= POSITION_MM, f"told to go to {to_mm:g} mm it {verb} at {at_mm:.3f} mm")
        require(stage.is_position_known, f"after a move to {to_mm:g} mm its position is unknown")


def _reports_position(rig: DriverRig) -> None:
    stage = rig.homed()
    stage.begin(Move(20.0, _speed_mm_s(stage)))
    rig.truth.clear()
    polls = rig.poll_stage(stage, 2.0)
    require(len(polls) >= 8, f"{len(polls)} positions in 2 s; at least 8 were expected")
    times_s, true_mm = np.array(rig.truth).T
    for poll in polls[1:]:
        off_mm = abs(poll.position_mm - float(np.interp(poll.host_s, times_s, true_mm)))
        allowed_mm = POSITION_MM + POLL_S * _speed_mm_s(stage)
        require(off_mm <= allowed_mm, f"it says {poll.position_mm:.3f} mm, off by {off_mm:.3f} mm")


def _refuses(rig: DriverRig) -> None:
    stage = rig.homed()
    fine, before_mm = _speed_mm_s(stage), rig.position_mm()
    for move, when in (
        (Move(stage.travel_mm + 1.0, fine), "beyond its travel"),
        (Move(-1.0, fine), "behind its switch"),
        (Move(5.0, 2 * stage.max_speed_mm_s), "faster than it can"),
        (Move(5.0, 0.0), "without a speed"),
    ):
        _expect_refusal(stage, move, when)
    rig.poll_stage(stage, 0.3)
    require(abs(rig.position_mm() - before_mm) <= POSITION_MM, "it moved although it refused")
    stage.begin(Move(20.0, fine))
    _expect_refusal(stage, Move(1.0, fine), "while it moves")


def _stops(rig: DriverRig) -> None:
    for moving_s in (0.0, 0.5):
        stage = rig.homed()
        _go(rig, stage, 2.0)
        stage.begin(Move(stage.travel_mm, _speed_mm_s(stage)))
        rig.poll_stage(stage, moving_s)
        began_s = rig.clock.now_s()
        stage.stop()
        took_s, allowed_s = rig.clock.now_s() - began_s, STOP_S + _braking_s(stage)
        require(took_s <= allowed_s, f"stop() took {took_s:.2f} s, {allowed_s:.2f} s were expected")
        require(rig.comes_to_rest(_braking_s(stage)), "after stop() it moves on")
        require(not stage.is_moving, "is_moving after stop()")
        rig.fault_within(0.3, stage.poll)  # It may say that the stop cost its position.
        off_mm = abs(stage.position_mm - rig.position_mm())
        is_true = not stage.is_position_known or off_mm <= POSITION_MM
        require(is_true, f"after stop() it says {stage.position_mm:.3f} mm, {rig.position_mm():.3f} mm is true")
        stage.close()


def _can_be_broken_off_while_homing(rig: DriverRig) -> None:
    stage: Stage = rig.open()
    rig.axis.position_mm = 15.0

    def break_off() -> None:
        raise _BrokenOffError

    try:
        stage.home(break_off)
    except _BrokenOffError:
        pass
    else:
        require(False, "what on_wait raised did not come through")
    stage.stop()
    require(rig.comes_to_rest(STOP_S), "broken off while homing, then stopped, it moves on")
    require(not stage.is_position_known, "its position is called known although homing was broken off")


def _under_fault(break_it: Callable[[DriverRig], None], must_stand: bool = True) -> Callable[[DriverRig], None]:
    def examine(rig: DriverRig) -> None:
        stage = rig.homed()
        stage.begin(Move(stage.travel_mm, min(4.0, _speed_mm_s(stage))))
        rig.poll_stage(stage, 0.5)
        break_it(rig)
        _, error = rig.fault_within(DETECTION_S, stage.poll)
        require(error is not None, f"for {DETECTION_S:g} s in a move nothing is said of it")
        try:
            stage.stop()
        except DeviceError:
            pass  # It was told, and says that nothing came back.
        if must_stand:
            require(rig.comes_to_rest(STOP_S), "stopped, it moves on")

    return examine


def _set(switch: str, value: object) -> Callable[[DriverRig], None]:
    return lambda rig: setattr(rig.wire, switch, value)


STAGE: dict[str, Callable[[DriverRig], None]] = {
    "it moves only when it is homed": _moves_only_when_homed,
    "it homes, and lets itself be watched": _homes,
    "it goes where it is told": _check_targets,
    "it says where it is while it moves": _reports_position,
    "it refuses what it cannot do, and sends nothing": _refuses,
    "it stops at once and stays": _stops,
    "homing can be broken off": _can_be_broken_off_while_homing,
    "a silent controller is said at once, and told to stop": _under_fault(_set("is_silent", True)),
    "noise is said at once, and the stage stopped": _under_fault(_set("garbage", 1.0)),
    "a controller that is gone is said at once": _under_fault(lambda rig: rig.wire.unplug(), must_stand=False),
}
"""Sentence -> what looks at it."""
