"""Bytes of the GRBL 1.1 interface (gnea/grbl wiki, and lines captured from controllers) to values and back."""

import pytest

from softcal.core.errors import BadReply
from softcal.station.wire.frames import grbl


def test_status_report_of_the_manual():
    status = grbl.parse(b"<Idle|MPos:0.000,0.000,-3.250|FS:0,0|Pn:PXYZRHS|Bf:15,128|Ln:99>")
    assert status == grbl.GrblStatus("Idle", 0, (0.0, 0.0, -3.25), pins="PXYZRHS")


def test_work_position_and_offset_are_kept_apart():
    status = grbl.parse(b"<Hold:1|WPos:0.000,0.000,1.500|FS:0,0|WCO:0.000,0.000,-5.000>")
    assert (status.state, status.substate, status.machine_mm) == ("Hold", 1, None)
    assert status.work_mm == (0.0, 0.0, 1.5)
    assert status.offset_mm == (0.0, 0.0, -5.0)


def test_unknown_fields_of_grblhal_are_ignored():
    assert grbl.parse(b"<Run|MPos:1.0,2.0,3.0|Bf:100,1023|H:1,7|FS:500,0>") == grbl.GrblStatus(
        "Run", 0, (1.0, 2.0, 3.0)
    )


@pytest.mark.parametrize("line", [b"Grbl 1.1h ['$' for help]", b"GrblHAL 1.1f ['$' or '$HELP' for help]"])
def test_greetings(line):
    assert isinstance(grbl.parse(line), grbl.Greeting)


def test_answers():
    assert grbl.parse(b"ok") == grbl.Ok()
    assert grbl.parse(b"error:9") == grbl.GrblRefusal(9)
    assert grbl.parse(b"ALARM:3") == grbl.Alarm(3)
    assert grbl.parse(b"$122=250.000") == grbl.Setting(122, 250.0)


@pytest.mark.parametrize(
    "line", [b"", b"[MSG:Reset to continue]", b"[PRB:0.000,0.000,-4.221:1]", b">G54G20:ok", b">:error:7"]
)
def test_push_messages_ask_for_nothing(line):
    assert grbl.parse(line) == grbl.GrblNote(line.decode())


@pytest.mark.parametrize("line", [b"o", b"okok", b"\xff\xfe", b"<Idle|MPos:0.0", b"<Lost|MPos:0,0,0>", b"error:x"])
def test_what_grbl_does_not_say_is_refused(line):
    with pytest.raises(BadReply):
        grbl.parse(line)


@pytest.mark.parametrize(("code", "is_lost"), [(1, True), (2, False), (3, True), (4, False), (5, False), (8, True)])
def test_which_alarms_lose_the_position(code, is_lost):
    assert grbl.Alarm(code).loses_position is is_lost


def test_a_move_is_one_line_in_machine_coordinates_with_feed_per_minute():
    line = grbl.move_line("Z", -12.5, 2.0)
    assert line == b"G90 G21 G53 G1 Z-12.5000 F120.000\n"
    assert len(line) < grbl.LINE_LENGTH
