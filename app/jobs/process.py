"""A job in a separate process, `python -m softcal.app.jobs.process ID`."""

import os
import sys

from softcal.app.bootstrap import open_chosen_registry
from softcal.app.jobs.jobs import run_job


def main(job_id: str) -> None:
    """Perform one job of the registry of the environment."""
    with open_chosen_registry(None) as registry:
        # Whatever a job registers is registered whole or not at all: it can be ended anywhere.
        run_job(registry, job_id, on_cancel=lambda: os._exit(0))


if __name__ == "__main__":
    main(sys.argv[1])
