"""What softcal writes down for support: JSON lines, one file a day, without secrets."""

import contextlib
import os
import re
import sys
import time
import traceback
import uuid
from collections.abc import Mapping, MutableMapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from softcal.app.bootstrap import data_folder
from softcal.core.errors import SoftcalError

LOGS_VARIABLE = "SOFTCAL_LOGS"
MAX_AGE_DAYS = 30
LARGEST_BYTES = 50_000_000
"""A file this large is set aside and another one begun: one editor must still open it."""

PASSWORD_IN_URL = re.compile(r"(://[^:/@\s]*):[^\s\"']*@")
"""From the colon to the last @ of the word: a password may hold an @ itself."""

PASSWORD_IN_QUERY = re.compile(r"((?:password|sslpassword)=)[^&\s\"']*", re.IGNORECASE)
SECRET_KEYS = ("pin", "password", "token", "secret")


def log_folder() -> Path:
    """Return the one folder of logs: $SOFTCAL_LOGS, else `logs` in softcal's data folder."""
    folder = Path(os.environ.get(LOGS_VARIABLE) or data_folder() / "logs")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


class DayFiles:
    """Appends whole lines to the file of the day; open only while a line is written.

    Work goes on where the log cannot be written: the disk that is full for it is full for the registry, which says so.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def msg(self, line: str) -> None:
        """Append one line; a file of the day that grew too large is set aside first."""
        path = self._folder / f"softcal-{datetime.now(UTC):%Y-%m-%d}.jsonl"
        with contextlib.suppress(OSError):
            if path.exists() and path.stat().st_size > LARGEST_BYTES:
                path.rename(path.with_name(f"{path.stem}-{datetime.now(UTC):%H%M%S%f}.jsonl"))
            with path.open("a", encoding="utf-8") as file:
                file.write(f"{line}\n")

    debug = info = warning = error = critical = msg  # noqa: V107


def start_logging(**context: str) -> Any:
    """Return a logger whose lines carry `context` (command, station, lot, serial) and a run id.

    Processes share the file of the day, because whole lines are appended; files older than 30 days are removed.
    """
    # Importing structlog takes a third of a second: commands that log nothing do not pay for it.
    import structlog

    folder = log_folder()
    oldest = time.time() - MAX_AGE_DAYS * 86_400
    for path in folder.glob("softcal-*.jsonl"):
        if path.stat().st_mtime < oldest:
            path.unlink(missing_ok=True)
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.format_exc_info,
            mask_secrets,
            structlog.processors.JSONRenderer(default=str),
        ],
        logger_factory=lambda *_: DayFiles(folder),
    )
    structlog.contextvars.clear_contextvars()
    structlog.contextvars.bind_contextvars(run=uuid.uuid4().hex[:12], process=os.getpid(), **context)
    return structlog.get_logger()


def begin_run(command: str, arguments: Sequence[str], **context: str) -> Any:
    """Begin the log of one command; return its logger, or None where no log can be written."""
    try:
        log = start_logging(command=command, **context)
    except (OSError, ImportError, SoftcalError):
        return None
    log.info("begun", arguments=list(arguments), version=version("softcal"))
    return log


def end_run(log: Any, code: int, message: str) -> None:
    """End the log of a command with its exit code and what it said where it did not end well."""
    import structlog

    log.info("ended", code=code, said=message)
    structlog.contextvars.clear_contextvars()


def note(event: str, **values: object) -> None:
    """Put what happened into the log of the run that is under way; nothing where none was begun."""
    log = _run_logger()
    if log is not None:
        log.info(event, **values)


def _run_logger() -> Any:
    structlog = sys.modules.get("structlog")
    is_begun = structlog is not None and "run" in structlog.contextvars.get_contextvars()
    return structlog.get_logger() if structlog is not None and is_begun else None


def log_crash(error: BaseException, command: str) -> str:
    """Write a defect of softcal to the log; return the one line for the person."""
    summary = mask_passwords(f"{type(error).__name__}: {error}".splitlines()[0])
    try:
        log = _run_logger() or start_logging(command=command)
        log.error("crash", error=summary, traceback="".join(traceback.format_exception(error)))
        location = f"the details are in {log_folder()}; `softcal doctor --out FILE.zip` collects them"
    except (OSError, ImportError) as trouble:
        location = f"the log could not be written: {trouble}"
    return f"a defect of softcal stopped this command ({summary}); {location}"


def mask_secrets(logger: object, method: str, event: MutableMapping[str, Any]) -> Mapping[str, Any]:
    """Mask passwords in URLs and everything whose name says that it is a secret."""
    for key, value in event.items():
        if any(secret in key.lower() for secret in SECRET_KEYS):
            event[key] = "***"
        elif isinstance(value, str):
            event[key] = mask_passwords(value)
        elif isinstance(value, list):
            event[key] = [mask_passwords(part) if isinstance(part, str) else part for part in value]
    return event


def mask_passwords(text: str) -> str:
    """Return a text with the passwords in its URLs masked."""
    return PASSWORD_IN_QUERY.sub(r"\1***", PASSWORD_IN_URL.sub(r"\1:***@", text))
