"""Diagnostic data of an installation for support, without secrets."""

import os
import platform
import shutil
import sys
import zipfile
from contextlib import suppress
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from softcal.app.bootstrap import data_folder, open_chosen_registry, registry_url
from softcal.app.files.atomic import whole_file
from softcal.app.logs import log_folder, masked
from softcal.app.texts.catalogue import here
from softcal.core.errors import SoftcalError

PACKAGES = ("softcal", "numpy", "scipy", "numba", "torch", "pot", "sqlalchemy", "alembic", "psycopg", "pyserial",
            "streamlit", "distributed", "onnx")  # fmt: skip
LEAST_FREE_GB = 2.0
Facts = dict[str, object]


def examine(url_option: str | None) -> tuple[Facts, list[str]]:
    """Return the diagnostic data of this installation, with its faults in words."""
    problems: list[str] = []
    packages: dict[str, str | None] = dict.fromkeys(PACKAGES)
    for name in PACKAGES:
        with suppress(PackageNotFoundError):
            packages[name] = version(name)
    facts: Facts = {
        "python": sys.version.split()[0],
        "system": platform.platform(),
        "cores": os.cpu_count(),
        "packages": packages,
        "environment": {k: masked(v) for k, v in sorted(os.environ.items()) if k.startswith("SOFTCAL_")},
    }
    for name, look in (("folders", _folders), ("registry", partial(_registry, url_option))):
        try:
            facts[name] = look(problems)
        except (SoftcalError, OSError) as error:
            problems.append(masked(str(error)))
            facts[name] = {"error": masked(str(error))}
    return facts, problems


def collect(path: Path, report: str) -> int:
    """Write report and logs into a zip file, whole or not at all; return how many logs."""
    logs = sorted(log_folder().glob("softcal-*.jsonl"))
    with whole_file(path) as part, zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as bundle:
        bundle.writestr("report.json", report)
        for log in logs:
            bundle.writestr(f"logs/{log.name}", masked(log.read_text(encoding="utf-8", errors="replace")))
    return len(logs)


def _folders(problems: list[str]) -> Facts:
    data, logs = data_folder(), log_folder()
    free_GB = shutil.disk_usage(data).free / 1e9
    if free_GB < LEAST_FREE_GB:
        problems.append(f"{data}: only {free_GB:.1f} GB are free; at least {LEAST_FREE_GB:g} GB are wanted")
    if not os.access(data, os.W_OK):
        problems.append(f"{data}: cannot be written")
    return {"data": str(data), "logs": str(logs), "free_GB": round(free_GB, 1)}


def _registry(url_option: str | None, problems: list[str]) -> Facts:
    facts: Facts = {"url": masked(registry_url(url_option))}
    with open_chosen_registry(url_option, create=False) as registry:
        units = registry.lots.units()
        stations = {beat.station: f"{beat.state}, last seen {here(beat.at)}"
                    for beat in registry.order_queue.stations()}  # fmt: skip
        faults = registry.verify()
        facts |= {"origin": registry.origin, "lots": len(registry.lots.all()), "units": len(units)}
        facts |= {"work_items": registry.work_queue.counts(), "stations": stations, "faults": faults}
    problems += [f"registry: {fault}" for fault in faults[:5]]
    return facts
