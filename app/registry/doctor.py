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
from softcal.app.files.atomic import atomic_file
from softcal.app.logs import log_folder, mask_passwords
from softcal.app.texts.catalogue import format_local_instant
from softcal.core.errors import SoftcalError

PACKAGES = ("softcal", "numpy", "scipy", "numba", "torch", "pot", "sqlalchemy", "alembic", "psycopg", "pyserial",
            "streamlit", "distributed", "onnx")  # fmt: skip
MIN_FREE_GB = 2.0
Section = dict[str, object]


def examine(url_option: str | None) -> tuple[Section, list[str]]:
    """Return the diagnostic data of this installation, with its faults in words."""
    problems: list[str] = []
    packages: dict[str, str | None] = dict.fromkeys(PACKAGES)
    for name in PACKAGES:
        with suppress(PackageNotFoundError):
            packages[name] = version(name)
    report: Section = {
        "python": sys.version.split()[0],
        "system": platform.platform(),
        "cores": os.cpu_count(),
        "packages": packages,
        "environment": {k: mask_passwords(v) for k, v in sorted(os.environ.items()) if k.startswith("SOFTCAL_")},
    }
    for name, examine_part in (("folders", _folders), ("registry", partial(_registry, url_option))):
        try:
            report[name] = examine_part(problems)
        except (SoftcalError, OSError) as error:
            problems.append(mask_passwords(str(error)))
            report[name] = {"error": mask_passwords(str(error))}
    return report, problems


def collect(path: Path, report: str) -> int:
    """Write report and logs into a zip file, whole or not at all; return how many logs."""
    logs = sorted(log_folder().glob("softcal-*.jsonl"))
    with atomic_file(path) as part, zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as bundle:
        bundle.writestr("report.json", report)
        for log in logs:
            bundle.writestr(f"logs/{log.name}", mask_passwords(log.read_text(encoding="utf-8", errors="replace")))
    return len(logs)


def _folders(problems: list[str]) -> Section:
    data, logs = data_folder(), log_folder()
    free_GB = shutil.disk_usage(data).free / 1e9
    if free_GB < MIN_FREE_GB:
        problems.append(f"{data}: only {free_GB:.1f} GB are free; at least {MIN_FREE_GB:g} GB are wanted")
    if not os.access(data, os.W_OK):
        problems.append(f"{data}: cannot be written")
    return {"data": str(data), "logs": str(logs), "free_GB": round(free_GB, 1)}


def _registry(url_option: str | None, problems: list[str]) -> Section:
    section: Section = {"url": mask_passwords(registry_url(url_option))}
    with open_chosen_registry(url_option, create=False) as registry:
        units = registry.lots.units()
        stations = {heartbeat.station: f"{heartbeat.state}, last seen {format_local_instant(heartbeat.at)}"
                    for heartbeat in registry.order_queue.stations()}  # fmt: skip
        faults = registry.verify()
        section |= {"origin": registry.origin, "lots": len(registry.lots.all()), "units": len(units)}
        section |= {"work_items": registry.work_queue.counts(), "stations": stations, "faults": faults}
    problems += [f"registry: {fault}" for fault in faults[:5]]
    return section
