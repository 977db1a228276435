"""`softcal station recover`: whatever one spool is like, every other one is recovered, and nothing is written over."""

import json
import zlib

import numpy as np
import pytest

from softcal.app.line.recover import recover
from softcal.core.profiles import ramps
from softcal.station.bench.bench import open_simulated_bench
from softcal.station.interfaces import Sample, StagePosition
from softcal.station.record.spool import Spool
from softcal.station.tasks.acquisition import record


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The spool of a finished run."""
    path = tmp_path_factory.mktemp("whole") / "z.spool"
    with open_simulated_bench(seed=2) as (bench, _), Spool(path, {"serial": "Z9", "profile": "ramps"}) as spool:
        record(bench, "Z9", ramps([2.0], 4.0, rest_s=0.5), True, spool=spool)
    return path.read_bytes()


def _line(value):
    text = json.dumps(value).encode()
    return b"%08x %s\n" % (zlib.crc32(text), text)


def change_header(whole, **changes):
    """The spool with other facts, every checksum right."""
    lines = whole.split(b"\n")
    for k, line in enumerate(lines):
        if b'"facts"' in line:
            header = json.loads(line.partition(b" ")[2])["facts"] | changes
            lines[k] = _line({"facts": {key: value for key, value in header.items() if value is not None}}).rstrip()
    return b"\n".join(lines)


BAD = {
    "empty": lambda whole: b"",
    "zeros": lambda whole: bytes(4096),
    "zeros after a header": lambda whole: whole[: whole.index(b"\n") + 1] + bytes(4096),
    "torn in its first line": lambda whole: whole[:20],
    "torn in the middle": lambda whole: whole[: len(whole) // 2],
    "torn in its last line": lambda whole: whole[:-3],
    "header alone": lambda whole: whole[: whole.index(b"\n") + 1],
    "noise": lambda whole: np.random.default_rng(1).bytes(5000),
    "a serial that is none": lambda whole: _line({"schema": "softcal.spool/1", "serial": "../x"}),
    "a header that is no table": lambda whole: _line([1, 2]),
    "rows that are none": lambda whole: whole[: whole.index(b"\n") + 1] + _line({"output": [[1.0]], "polls": [3]}),
    "facts of another version": lambda whole: change_header(whole, moves=None, new_fact=1),
    "facts that do not fit": lambda whole: change_header(whole, span_s=[1e9, 2e9]),
    "a recording that is refused today": lambda whole: change_header(whole, sample_rate_Hz=200.0),
    "two finished runs": lambda whole: whole + whole,
}


@pytest.mark.long
@pytest.mark.parametrize("bad", BAD)
def test_one_bad_spool_keeps_no_other_from_being_recovered(bad, whole, tmp_path):
    (tmp_path / "spool").mkdir()
    (tmp_path / "spool" / "a.spool").write_bytes(BAD[bad](whole))
    (tmp_path / "spool" / "z.spool").write_bytes(whole)
    first, last = recover(tmp_path / "spool", tmp_path / "out")
    assert [file.name for file in last.files] == ["Z9.csv"]
    assert "\n" not in first.end and first.end
    assert (tmp_path / "out" / "Z9.csv") not in first.files


def test_a_folder_in_the_place_of_a_spool_is_named(whole, tmp_path):
    (tmp_path / "a.spool").mkdir()
    (tmp_path / "z.spool").write_bytes(whole)
    first, last = recover(tmp_path, tmp_path / "out")
    assert first.end and not first.files and last.end == "done"


def test_two_finished_runs_of_one_unit_are_both_kept(whole, tmp_path):
    (tmp_path / "a.spool").write_bytes(change_header(whole, zero_N=0.1))
    (tmp_path / "z.spool").write_bytes(whole)
    first, last = recover(tmp_path, tmp_path / "out")
    assert len({*first.files, *last.files}) == 2
    assert all(file.exists() for file in (*first.files, *last.files))


def test_recovering_twice_gives_the_same_files(whole, tmp_path):
    (tmp_path / "z.spool").write_bytes(whole)
    (once,) = recover(tmp_path, tmp_path / "out")
    (twice,) = recover(tmp_path, tmp_path / "out")
    assert once.files == twice.files and len(list((tmp_path / "out").iterdir())) == 1


def test_a_recording_of_before_is_not_written_over(whole, tmp_path):
    (tmp_path / "z.spool").write_bytes(whole)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "Z9.csv").write_text("t_s,output\n0.0,1.0\n")
    (recovered_run,) = recover(tmp_path, tmp_path / "out")
    assert (tmp_path / "out" / "Z9.csv").read_text() == "t_s,output\n0.0,1.0\n"
    assert recovered_run.files and recovered_run.files[0].exists()


OUTPUT, CELL = ([Sample(0.1 * k, 0.1 * k, (level,)) for k in range(5)] for level in (0.5, 1.0))
POLLS = [StagePosition(0.2 * k, k) for k in range(3)]
SILENT = {
    "output": ([], CELL, POLLS),
    "force": (OUTPUT, [], POLLS),
    "output and force": ([], [], POLLS),
    "stage": (OUTPUT, CELL[:1], []),
}


@pytest.mark.parametrize("silent", SILENT)
def test_an_aborted_run_keeps_every_channel_that_spoke(silent, tmp_path):
    output, cell, polls = SILENT[silent]
    with pytest.raises(KeyboardInterrupt), Spool(tmp_path / "a.spool", {"serial": "A1"}) as spool:
        spool.append(output, cell, polls)
        raise KeyboardInterrupt
    (recovered_run,) = recover(tmp_path, tmp_path / "out")
    header, *rows = recovered_run.files[0].read_text().splitlines()
    spoke = {"output_0": output, "force_N": cell, "stage_mm": polls}
    assert {name for name in spoke if name in header.split(",")} == {name for name, channel in spoke.items() if channel}
    assert len(rows) == max(1, len(output) or len(cell) or len(polls))


def test_before_a_channel_spoke_and_after_it_fell_silent_nothing_is_made_up(tmp_path):
    output = [Sample(k / 10, k / 10, (0.5,)) for k in range(11)]
    with pytest.raises(KeyboardInterrupt), Spool(tmp_path / "a.spool", {"serial": "A1"}) as spool:
        spool.append(output, [Sample(0.4, 0.4, (1.0,)), Sample(0.6, 0.6, (3.0,))], [])
        raise KeyboardInterrupt
    (recovered_run,) = recover(tmp_path, tmp_path / "out")
    header, *rows = recovered_run.files[0].read_text().splitlines()
    at = header.split(",").index("force_N")
    assert [row.split(",")[at] for row in rows[3:8]] == ["", "1.0", "2.0", "3.0", ""]
