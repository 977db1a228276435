"""Start and end of a separate process for a job or a simulated station, which outlives the page and its server."""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from softcal.app.bootstrap import ONE_THREAD, is_alive
from softcal.app.logs import log_folder
from softcal.db.registry import Registry

DEMO = "demo"
"""Name of the demo's lot."""

SIMULATED = "simulated-1"
"""Name of the simulated station that a page starts."""


def start_job(registry: Registry, kind: str, request: Mapping[str, Any], actor: str) -> str:
    """Write a job down, start its process and return its id."""
    job_id = registry.job_board.place(kind, request, actor)
    launch(job_id)
    return job_id


def launch(job_id: str, on_end: Callable[[], None] = lambda: None) -> None:
    """Start the process of a job, on one core, with the registry of the environment; it outlives this process.

    `on_end` is called in a thread once the process has ended, however it did.
    """
    _start_process(["softcal.app.jobs.process", job_id], "jobs.log", f"job {job_id}", ONE_THREAD, on_end)


def start_simulated_station(name: str) -> None:
    """Start a simulated station's service on the registry of the environment."""
    _start_process(["softcal.app.cli.main", "station", "serve", "--simulated", "--name", name], "station.log", name)


def end_simulated_station(registry: Registry, name: str) -> None:
    """Ask the service of a simulated station of this machine to end; one that does not answer is left alone."""
    heartbeat = registry.order_queue.heartbeat(name)
    if heartbeat is not None and registry.order_queue.is_answering(name) and is_alive(heartbeat.process):
        os.kill(int(heartbeat.process.rpartition(":")[2]), signal.SIGTERM)


def _start_process(
    arguments: list[str],
    log_name: str,
    name: str,
    environment: Mapping[str, str] = MappingProxyType({}),
    on_end: Callable[[], None] = lambda: None,
) -> None:
    with (log_folder() / log_name).open("ab") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", *arguments],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            start_new_session=True,
            env={**os.environ, **environment},
        )

    # Somebody has to take note of its end, or it stays in the table of processes for as long as the screens run.
    def wait() -> None:
        process.wait()
        on_end()

    threading.Thread(target=wait, name=name, daemon=True).start()
