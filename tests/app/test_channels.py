"""Several units under one stage: one recording, one spool, and after a power cut one file for each of them."""

import numpy as np
import pandas as pd
import pytest

from softcal.app.line.pressed_run import RunStore
from softcal.app.line.recover import recover
from softcal.core.lot import Lot
from softcal.core.orders import Order, OrderKind, RunState
from softcal.core.profiles import ramps
from softcal.core.simulated_lot import draw_lot
from softcal.db.connection import open_registry
from softcal.station.bench.bench import open_simulated_bench
from softcal.station.record.spool import Spool
from softcal.station.tasks.acquisition import record


@pytest.fixture(scope="module")
def spool_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("spool")
    units = draw_lot(np.random.default_rng(1), 3)
    with open_simulated_bench(units[0], seed=1, other_units=units[1:]) as (bench, _):
        with Spool(folder / "run.spool", {"serial": "A1", "serials": "A1,A2,A3"}) as spool:
            return record(bench, "A1", ramps([2.0], 3.0, rest_s=0.5), with_reference=False, spool=spool), folder


def test_every_channel_of_a_finished_run_is_recovered_under_its_serial(spool_folder, tmp_path):
    recording, folder = spool_folder
    (recovered_run,) = recover(folder, tmp_path)
    assert [file.name for file in recovered_run.files] == ["A1.csv", "A2.csv", "A3.csv"]
    for channel, file in enumerate(recovered_run.files):
        np.testing.assert_allclose(pd.read_csv(file)["output"], recording.output[:, channel], atol=1e-6)


def test_each_unit_of_a_substrate_is_kept_with_a_serial_of_its_own(spool_folder, tmp_path):
    recording, _ = spool_folder
    with open_registry(f"sqlite:///{tmp_path / 'r.db'}") as registry:
        registry.lots.add(Lot("L1", "A0", 50.0))
        order = Order("o1", "s1", OrderKind.UNIT, "SUB1", "L1")
        final_progress = RunStore(registry, "s1").store(order, recording, lambda progress: None)
        assert final_progress.state is RunState.DONE
        assert [unit.serial for unit in registry.lots.units("L1")] == ["A0", "SUB1-1", "SUB1-2", "SUB1-3"]
