"""The service killed in the middle of a run: the screen sees it, no half run counts, its samples are not lost."""

import os
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pandas as pd
import pytest

from softcal.app.line.recover import recover
from softcal.core.orders import Order, OrderKind, RunState
from softcal.db.connection import open_registry
from tests.wait import wait_until

pytestmark = pytest.mark.long

SOFTCAL = Path(sys.executable).with_name("softcal")


@contextmanager
def served(url, folder):
    command = [SOFTCAL, "station", "serve", "--simulated", "--name", "s1", "--registry", url, "--speed", "4"]
    environment = os.environ | {"SOFTCAL_LOGS": str(folder / "logs")}
    process = subprocess.Popen([*command, "--spool", str(folder / "spool")], stderr=subprocess.DEVNULL, env=environment)
    try:
        yield process
    finally:
        process.terminate()
        process.wait(30)


def test_a_killed_service_leaves_an_interrupted_run_and_its_samples(tmp_path):
    url = f"sqlite:///{tmp_path / 'r.db'}"
    with open_registry(url) as registry:
        queue = registry.order_queue
        with served(url, tmp_path) as process:
            wait_until(lambda: queue.is_answering("s1"))
            queue.place(Order("o1", "s1", OrderKind.SOURCE, "A0", "L1"))
            wait_until(lambda: queue.progress("o1").phase == "pressing" and queue.progress("o1").fraction > 0.1)
            process.send_signal(signal.SIGKILL)
            process.wait(30)
        wait_until(lambda: not queue.is_answering("s1"))
        assert queue.progress("o1").state is RunState.RUNNING  # Nobody is there to say otherwise.
        (spooled,) = recover(tmp_path / "spool", tmp_path / "recovered")
        assert str(spooled.end) == "cut off"
        assert len(pd.read_csv(spooled.files[0])) == spooled.samples > 400
        with served(url, tmp_path):
            wait_until(lambda: not queue.progress("o1").state.is_active)
            assert queue.progress("o1").code == "E-INTERRUPTED"
            assert queue.progress("o1").state is RunState.ERROR
        assert registry.lots.all() == []  # Nothing of the half run was stored.
