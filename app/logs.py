"""What softcal writes down for support: JSON lines with the run they belong to, one file a day, without secrets."""

import os
import re
import time
import traceback
import uuid
from collections.abc import Mapping, MutableMapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from softcal.app.bootstrap import data_folder

LOGS_VARIABLE = "SOFTCAL_LOGS"
KEPT_DAYS = 30
PASSWORD_IN_URL = re.compile(r"(://[^:/@\s]*):[^@\s]*@")
SECRET_KEYS = ("pin", "password", "token", "secret")


def log_folder() -> Path:
    """Return the one folder of logs: $SOFTCAL_LOGS, else `logs` in softcal's data folder."""
    folder = Path(os.environ.get(LOGS_VARIABLE) or data_folder() / "logs")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


class DayFiles:
    """Appends whole lines to the file of the day; open only while a line is written."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def msg(self, line: str) -> None:
        """Append one line."""
        path = self._folder / f"softcal-{datetime.now(UTC):%Y-%m-%d}.jsonl"
        with path.open("a", encoding="utf-8") as file:
            file.write(f"{line}\n")

    debug = info = warning = error = critical = msg


def start_logging(**context: str) -> Any:
    """Return a structlog logger whose lines carry `context` (command, station, lot, serial) and a run id.

    Processes share the file of the day, because whole lines are appended; files older than 30 days are removed.
    """
    # Importing structlog takes a third of a second: commands that log nothing do not pay for it.
    import structlog

    folder = log_folder()
    _remove_old(folder)
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.format_exc_info,
            without_secrets,
            structlog.processors.JSONRenderer(default=str),
        ],
        logger_factory=lambda *_: DayFiles(folder),
    )
    structlog.contextvars.clear_contextvars()
    structlog.contextvars.bind_contextvars(run=uuid.uuid4().hex[:12], process=os.getpid(), **context)
    return structlog.get_logger()


def log_crash(error: BaseException, command: str) -> str:
    """Write a defect of softcal with its traceback to the log and return the one line for the person."""
    what = masked(f"{type(error).__name__}: {error}".splitlines()[0])
    try:
        start_logging(command=command).error("crash", error=what, traceback="".join(traceback.format_exception(error)))
        where = f"the details are in {log_folder()}; `softcal doctor --out FILE.zip` collects them"
    except (OSError, ImportError) as trouble:
        where = f"the log could not be written: {trouble}"
    return f"a defect of softcal stopped this command ({what}); {where}"


def without_secrets(logger: object, method: str, event: MutableMapping[str, Any]) -> Mapping[str, Any]:
    """Mask passwords in URLs and everything whose name says that it is a secret."""
    for key, value in event.items():
        if any(secret in key.lower() for secret in SECRET_KEYS):
            event[key] = "***"
        elif isinstance(value, str):
            event[key] = masked(value)
    return event


def masked(text: str) -> str:
    """Return a text with the passwords in its URLs masked."""
    return PASSWORD_IN_URL.sub(r"\1:***@", text)


def _remove_old(folder: Path) -> None:
    oldest = time.time() - KEPT_DAYS * 86_400
    for path in folder.glob("softcal-*.jsonl"):
        if path.stat().st_mtime < oldest:
            path.unlink(missing_ok=True)
