"""Samples on disk as they come: a power cut costs the last moment, damage is seen, a full disk stops the run."""

import threading
import zlib
from pathlib import Path

import numpy as np
import pytest
from common.fault_trial import FillingSpool

from softcal.core.errors import DeviceError, InputError
from softcal.core.profiles import ramps
from softcal.station.bench.bench import open_simulated_bench
from softcal.station.interfaces import Sample, StagePosition
from softcal.station.record.recording import restore
from softcal.station.record.spool import Spool, read_spool
from softcal.station.tasks.acquisition import record

SAMPLES = [Sample(0.1 * k, 0.02 * k, (float(k),)) for k in range(5)]


def write(path: Path) -> Path:
    with Spool(path, {"serial": "A1"}) as spool:
        spool.append(SAMPLES, SAMPLES[:2], [StagePosition(0.1, 3.0)])
        spool.append((), (), ())
    return path


def test_what_was_read_comes_back(tmp_path):
    run = read_spool(write(tmp_path / "a.spool"))
    assert (run.header, run.is_complete, run.damaged) == ({"serial": "A1"}, True, 0)
    assert run.output == tuple(SAMPLES)
    assert run.polls == (StagePosition(0.1, 3.0),)


def test_every_cut_leaves_what_was_whole_before_it(tmp_path):
    path = write(tmp_path / "a.spool")
    content = path.read_bytes()
    first = content.index(b"\n") + 1
    for length in range(first, len(content) - 1):
        path.write_bytes(content[:length])
        run = read_spool(path)
        assert not run.is_complete
        assert len(run.output) in (0, 5)


def test_a_flipped_byte_is_seen(tmp_path, rng):
    path = write(tmp_path / "a.spool")
    content = bytearray(path.read_bytes())
    first = content.index(b"\n") + 1
    for position in rng.integers(first, len(content) - 1, 50):
        damaged = bytearray(content)
        damaged[position] ^= 0x01
        path.write_bytes(damaged)
        assert not read_spool(path).is_complete


DEEP, LONG = b"[" * 100_000 + b"]" * 100_000, b'{"schema":' + b"1" * 5_000 + b"}"


@pytest.mark.parametrize("line", [b"t_s,output", *(b"%08x %s" % (zlib.crc32(text), text) for text in (DEEP, LONG))])
def test_a_file_that_is_no_spool_is_refused(tmp_path, line):
    path = tmp_path / "a.spool"
    path.write_bytes(line + b"\n")
    with pytest.raises(InputError, match="a.spool"):
        read_spool(path)


def test_a_finished_run_is_made_again_from_its_spool(tmp_path):
    path = tmp_path / "a.spool"
    with open_simulated_bench(seed=2) as (bench, _), Spool(path, {"serial": "A1"}) as spool:
        recorded = record(bench, "A1", ramps([2.0], 4.0, rest_s=0.5), True, spool=spool)
    restored = restore(read_spool(path))
    np.testing.assert_array_equal(restored.output, recorded.output)
    np.testing.assert_array_equal(restored.force_N, recorded.force_N)
    np.testing.assert_array_equal(restored.stage_mm, recorded.stage_mm)


def test_an_aborted_run_never_becomes_a_recording(tmp_path):
    with pytest.raises(DeviceError), Spool(tmp_path / "a.spool", {"serial": "A1"}) as spool:
        spool.append(SAMPLES, (), ())
        raise DeviceError("unplugged")
    run = read_spool(tmp_path / "a.spool")
    assert (run.end.code, str(run.end.values["why"]), len(run.output)) == ("spool.aborted", "unplugged", 5)
    with pytest.raises(InputError):
        restore(run)


def test_a_full_disk_stops_the_run():
    with open_simulated_bench(seed=2) as (bench, station):
        with pytest.raises(DeviceError, match="No space left"):
            with Spool(Path("/dev/full"), {"serial": "A1"}) as spool:
                record(bench, "A1", ramps([2.0], 4.0, rest_s=0.5), True, spool=spool)
        assert not station.axis.is_moving


class FilledInMidWrite:
    """A file whose disk fills up once armed, after a line is written and before it is synced."""

    def __init__(self, file):
        self._file, self.fill, self.is_full = file, None, threading.Event()

    def write(self, data):
        count = self._file.write(data)
        if self.fill is not None:
            self.fill()
            self.fill = None
            self.is_full.set()
        return count

    def __getattr__(self, name):
        return getattr(self._file, name)


def test_a_disk_that_fills_up_between_a_write_and_its_sync_is_reported_as_a_full_one(tmp_path, monkeypatch):
    with monkeypatch.context() as patched:
        opened = Path.open
        patched.setattr(Path, "open", lambda path, mode: FilledInMidWrite(opened(path, mode)))
        spool = FillingSpool(tmp_path / "a.spool", {"serial": "A1"}, is_full_at_end=False)
    file = spool._file
    file.fill = spool.fill
    with pytest.raises(DeviceError, match="No space left"), spool:
        spool.append([Sample(0.0, 0.0, (1.0,))], [], [])
        assert file.is_full.wait(timeout=10.0)


def test_a_spool_that_cannot_be_made_moves_nothing(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(DeviceError, match="a.spool"):
        Spool(tmp_path / "file" / "a.spool", {})
