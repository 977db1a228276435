"""What the low pass of a load cell leaves counts: in the reference of the lot, and against the limit of the lot."""

from dataclasses import replace

import pytest

from softcal.app.files.lot_folder import open_lot_folder
from softcal.app.files.lot_toml import update_limit
from softcal.app.line.rig import record_to_files
from softcal.core.errors import BadReply
from softcal.core.profiles import moves
from softcal.station.bench.bench import open_simulated_bench
from softcal.station.devices.config import UNKNOWN_S
from softcal.station.testing.faults import filter_cell

SLOW = moves("slow", [0.0, 3.0, 0.0, 3.0, 0.0], [1.0, 1.0, 1.0, 2.5, 2.5], [0.5, 0.5, 0.5, 0.0, 1.0])


def press_source(folder, constant_s):
    with open_simulated_bench(seed=3) as (bench, station):
        if constant_s:
            filter_cell(station, constant_s)
        force = replace(bench.config.force, serial="K1", latency_s=UNKNOWN_S)
        bench_of_line = replace(bench, config=replace(bench.config, name="line-1", force=force))
        return record_to_files(bench_of_line, ["A0"], folder / "source" / "A0.csv", SLOW, True, folder / "spools")


def test_what_a_low_pass_leaves_is_uncertainty_of_the_reference_until_it_is_gone(tmp_path):
    run = press_source(tmp_path, 0.03)
    left_N = run.recording.alignment.force_response_N
    assert any("low pass" in remark for remark in run.remarks)
    assert open_lot_folder(tmp_path).reference.bandwidth == pytest.approx(left_N) and left_N > 0.0
    press_source(tmp_path, 0.0)
    assert open_lot_folder(tmp_path).reference.bandwidth == 0.0


def test_labels_that_a_low_pass_makes_too_wrong_for_the_limit_of_the_lot_are_not_written(tmp_path):
    first = press_source(tmp_path, 0.03)
    before = first.files[0].read_bytes()
    for share, is_refused in ((5.0, False), (3.0, True)):
        update_limit(tmp_path, share * first.recording.alignment.force_response_N)
        if is_refused:
            with pytest.raises(BadReply) as bad:
                press_source(tmp_path, 0.03)
            assert bad.value.reason.code == "rig.low_pass"
        else:
            press_source(tmp_path, 0.03)
            before = first.files[0].read_bytes()
    assert first.files[0].read_bytes() == before
