"""The REST answers: each one use case that commands and pages call, too."""

import hashlib
import io
import zipfile
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version
from typing import Annotated, Any, Literal, get_origin
from unicodedata import normalize

from fastapi import APIRouter, Depends, Header, Path, Query, Request, Response
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer
from pydantic import AfterValidator
from starlette.exceptions import HTTPException

from softcal.app.calibration.release import read_lot_status, statement_provenance
from softcal.app.calibration.results import lot_results, parquet_bytes
from softcal.app.connect.alert_monitor import open_alerts
from softcal.app.connect.events import CHANGE, KINDS, events_after
from softcal.app.connect.stations import order_json, stations_json
from softcal.app.export.calibrated_unit import ExportOptions, UnitLoader
from softcal.app.export.export import exported_file_record
from softcal.app.export.formats import find_writer
from softcal.app.export.names import DOCUMENT_FORMATS
from softcal.app.jobs.runner import JobRunner
from softcal.app.registry.exported_files import record_exported_files
from softcal.app.registry.listing import history_json, unit_json
from softcal.app.rest import v1 as answers
from softcal.app.texts.catalogue import text
from softcal.app.texts.reasons import render_message
from softcal.core.errors import InputError, NoSuchUnit
from softcal.core.lot import Lot, escape_serial
from softcal.core.maps.catalogue import check_family
from softcal.core.unit.verdict import Release
from softcal.db.access.people import PERMISSIONS, may, permissions
from softcal.db.entries import User
from softcal.db.queues.job_board import Job
from softcal.db.queues.outbox import cursor_of, cursor_text
from softcal.db.registry import Registry
from softcal.db.repositories.lot_pages import UnitFilter

MAX_ROWS = 500
"""Rows of one answer at most."""

PARQUET = "application/vnd.apache.parquet"
BEARER = HTTPBearer(auto_error=False, description="a token of `softcal api token create`")
NAME = r"^[^\x00-\x1f\x7f/]{1,64}$"
LotId = Annotated[str, Path(pattern=NAME, description="id of a lot")]
Serial = Annotated[str, Path(pattern=NAME, description="serial of a unit"), AfterValidator(partial(normalize, "NFC"))]
Limit = Annotated[int, Query(ge=1, le=MAX_ROWS, description="rows of one answer")]
After = Annotated[str, Query(max_length=2000, description="`next` of the last answer; nothing begins")]


def _rows_before(after: str) -> int:
    """Return the number of rows before a page; raise `InputError` for an unknown cursor."""
    if after and not (after.isascii() and after.isdigit() and len(after) < 10):
        raise InputError(f"cursor {after[:60]!r}: give what the last answer named `next`, or nothing for the beginning")
    return int(after or 0)


def _page(rows: Sequence[Any], after: str, limit: int, *, is_cut: bool = False) -> tuple[list[Any], str | None]:
    """Return the rows of a page and the cursor of the next one, None at the end.

    `is_cut`: `rows` begin with the page and hold one more row at most.
    """
    offset = _rows_before(after)
    page_rows = list(rows[:limit] if is_cut else rows[offset : offset + limit])
    has_more = len(rows) > (limit if is_cut else offset + limit)
    return page_rows, str(offset + limit) if has_more else None


def _registry(request: Request) -> Registry:
    registry: Registry = request.app.state.registry
    return registry


def _runner(request: Request) -> JobRunner:
    runner: JobRunner = request.app.state.jobs
    return runner


OpenRegistry = Annotated[Registry, Depends(_registry)]


def _user(request: Request, _: Annotated[HTTPAuthorizationCredentials | None, Depends(BEARER)]) -> User:
    user: User = request.state.user
    return user


SignedInUser = Annotated[User, Depends(_user)]


def _require_permission(action: str) -> Callable[[User], User]:
    def check(user: SignedInUser) -> User:
        if not may(user, action):
            roles = ", ".join(role for role, allowed in PERMISSIONS.items() if action in allowed)
            raise HTTPException(403, f"{user.role} may not do this; a token of {roles} may; nothing was changed")
        return user

    return check


Viewer = Annotated[User, Depends(_require_permission("look"))]
Calibrator = Annotated[User, Depends(_require_permission("calibrate"))]


def _error_responses(*statuses: int) -> dict[int | str, dict[str, Any]]:
    return {status: {"model": answers.ProblemAnswer, "description": "one line that says why"} for status in statuses}


def _file_response(media_type: str, description: str) -> dict[int | str, dict[str, Any]]:
    return {200: {"content": {media_type: {}}, "description": description}}


def _check_query(request: Request) -> None:
    """Refuse an unknown or repeated query parameter, which would otherwise be ignored."""
    fields = {field.alias: field.field_info.annotation for field in request.scope["route"].dependant.query_params}
    names = [name for name, _ in request.query_params.multi_items()]
    for name in names:
        if name not in fields:
            allowed = f"known: {', '.join(fields)}" if fields else "this path knows none"
            raise HTTPException(422, f"query.{name[:64]}: is unknown; {allowed}")
        if names.count(name) > 1 and get_origin(fields[name]) is not list:
            raise HTTPException(422, f"query.{name}: was given {names.count(name)} times; once was expected")


routes = APIRouter(dependencies=[Depends(_check_query)])


@routes.get("/me", response_model=answers.AccountAnswer, tags=["account"])
def me(user: SignedInUser) -> dict[str, Any]:
    """Return the account of this token."""
    account = {"account": user.name, "role": user.role, "permissions": sorted(permissions(user))}
    return account | {"version": version("softcal")}


@routes.get("/lots", response_model=answers.LotPageAnswer, responses=_error_responses(400), tags=["lots"])
def lots(registry: OpenRegistry, _: Viewer, after: After = "", limit: Limit = 50) -> dict[str, Any]:
    """List the lots by id."""
    page_rows, following = _page(registry.lots.ids(), after, limit)
    return {"lots": [_lot_json(registry, registry.lots.get(lot_id)) for lot_id in page_rows], "next": following}


@routes.get("/lots/{lot}", response_model=answers.LotAnswer, responses=_error_responses(404), tags=["lots"])
def lot_of(registry: OpenRegistry, _: Viewer, lot: LotId) -> dict[str, Any]:
    """Return one lot."""
    return _lot_json(registry, registry.lots.get(lot))


@routes.get("/lots/{lot}/release", response_model=answers.ReleaseAnswer, responses=_error_responses(404), tags=["lots"])
def release(registry: OpenRegistry, _: Viewer, lot: LotId) -> dict[str, Any]:
    """Return the release of a lot: released units with their evidence, waiting units, withdrawn units.

    Decides nothing.
    """
    status = read_lot_status(registry, lot)
    if status.decided is None:
        return {"lot": lot, "release": None, "provenance": None}
    provenance = statement_provenance(registry, status).to_json()
    return {"lot": lot, "release": status.to_json(), "provenance": provenance}


@routes.get(
    "/lots/{lot}/units", response_model=answers.UnitPageAnswer, responses=_error_responses(400, 404), tags=["units"]
)
def units(
    registry: OpenRegistry,
    _: Viewer,
    lot: LotId,
    verdict: Annotated[list[Literal[answers.Verdicts, "none"]], Query()] = [],  # noqa: B006
    text: Annotated[str, Query(pattern=r"^[^\x00]*$", description="serials that hold this text")] = "",
    sort: Literal["severity", "serial", "verdict", "made_at", "family", "predicted_rmse"] = "serial",
    descending: bool = False,
    after: After = "",
    limit: Limit = 50,
) -> dict[str, Any]:
    """List the target units of a lot with their verdicts, filtered and sorted."""
    offset, unit_filter = _rows_before(after), UnitFilter(tuple(verdict), text, sort, descending)
    rows = registry.pages.unit_page(lot, unit_filter, size=limit, before=offset)
    following = str(offset + limit) if offset + limit < rows.total else None
    return {"units": [unit_json(unit) for unit in rows.units], "total": rows.total, "next": following}


@routes.get(
    "/lots/{lot}/units/{serial}", response_model=answers.UnitAnswer, responses=_error_responses(404), tags=["units"]
)
def unit_of_lot(registry: OpenRegistry, _: Viewer, lot: LotId, serial: Serial) -> dict[str, Any]:
    """Return one unit of a lot."""
    return unit_json(_unit(registry, lot, serial))


@routes.get(
    "/lots/{lot}/units/{serial}/revisions",
    response_model=answers.RevisionsAnswer,
    responses=_error_responses(400, 404),
    tags=["units"],
)
def revisions(
    registry: OpenRegistry, _: Viewer, lot: LotId, serial: Serial, after: After = "", limit: Limit = 100
) -> dict[str, Any]:
    """Return every calibration of a unit, and the revision in use."""
    _unit(registry, lot, serial)
    page_rows, following = _page(registry.calibrations.history(serial, lot), after, limit)
    proofs = registry.recordings.proof_methods(lot, serial)
    return {
        "lot": lot,
        "serial": serial,
        "revisions": [history_json(one, proofs) for one in page_rows],
        "next": following,
    }


@routes.post(
    "/lots/{lot}/units/{serial}/files/{format}",
    response_class=Response,
    responses=_file_response("application/zip", "its files as one archive") | _error_responses(400, 404, 409),
    tags=["files"],
)
def files(
    registry: OpenRegistry,
    user: Calibrator,
    lot: LotId,
    serial: Serial,
    format: Annotated[str, Path(pattern=r"^[A-Za-z0-9_-]{1,32}$", description="json, c, blob, hex, onnx, pdf, dcc")],
    conditional: Annotated[bool, Query(description="conditional units have their files, too")] = False,
) -> Response:
    """Export the files of a unit with an entry in the audit trail; refuse a unit that is not released (409)."""
    _unit(registry, lot, serial)
    release = Release.CONDITIONAL if conditional else Release.PASS
    options = ExportOptions(release=release, lot_id=lot)
    unit = UnitLoader(registry, options).load(serial)
    contents = find_writer(format)(unit)
    if format not in DOCUMENT_FORMATS:
        record_exported_files(registry, {unit.stored.key: exported_file_record(unit)}, "REST")
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in contents.items():
            archive.writestr(zipfile.ZipInfo(name), content)
    registry.trail.add("export", "units", (lot, serial), {"formats": [format]}, actor=user.name)
    name = f"{escape_serial(lot)}-{escape_serial(serial)}-{format}.zip"
    return Response(
        buffer.getvalue(), 200, {"content-disposition": f'attachment; filename="{name}"'}, "application/zip"
    )


@routes.get(
    "/lots/{lot}/results.parquet",
    response_class=Response,
    responses=_file_response(PARQUET, "a row a unit") | _error_responses(404),
    tags=["files"],
)
def results(registry: OpenRegistry, _: Viewer, lot: LotId) -> Response:
    """Return the results of a lot as Parquet, one row per unit."""
    content = parquet_bytes(lot_results(registry, lot))
    return Response(content, 200, media_type=PARQUET)


@routes.get("/units", response_model=answers.UnitsAnswer, responses=_error_responses(400, 404), tags=["units"])
def units_of_serial(
    registry: OpenRegistry,
    _: Viewer,
    serial: Annotated[str, Query(pattern=NAME, description="serial"), AfterValidator(partial(normalize, "NFC"))],
    after: After = "",
    limit: Limit = 50,
) -> dict[str, Any]:
    """Return a serial in every lot that has it: lot and serial identify a unit."""
    page_rows, following = _page(registry.lots.units(serial=serial), after, limit)
    return {"units": [unit_json(unit) for unit in page_rows], "next": following}


@routes.post(
    "/jobs",
    response_model=answers.JobAnswer,
    status_code=202,
    responses=_error_responses(400, 404, 409, 429),
    tags=["jobs"],
)
def start(
    registry: OpenRegistry,
    runner: Annotated[JobRunner, Depends(_runner)],
    user: Calibrator,
    job_request: answers.JobRequest,
    response: Response,
    idempotency_key: Annotated[
        str | None, Header(pattern=r"^[\x21-\x7e]{1,255}$", description="the same key again is the same job")
    ] = None,
) -> dict[str, Any]:
    """Start a batch over a lot. Poll the job for its progress; a repeated request with one key is one job."""
    registry.lots.get(job_request.lot)
    family = {} if job_request.map is None else {"map": check_family(job_request.map)}
    request, board = {"lot": job_request.lot, **family}, registry.job_board
    job_id = None
    if idempotency_key is not None:
        job_id = hashlib.sha256(f"{user.name}\n{idempotency_key}".encode()).hexdigest()[:32]
    existing_job = None if job_id is None else board.find(job_id)
    if existing_job is not None and (existing_job.kind, existing_job.request) != (job_request.kind, request):
        raise HTTPException(409, "this Idempotency-Key was given for another request; give a new one; nothing was done")
    queued_id = (
        existing_job.job_id
        if existing_job is not None
        else board.place_bounded(job_request.kind, request, user.name, job_id)
    )
    runner.submit(queued_id)
    job = board.job(queued_id)
    response.headers["location"] = f"/v1/jobs/{queued_id}"
    return _job_json(job)


@routes.get("/jobs", response_model=answers.JobsAnswer, responses=_error_responses(400), tags=["jobs"])
def jobs(registry: OpenRegistry, _: Viewer, after: After = "", limit: Limit = 50) -> dict[str, Any]:
    """List the jobs, the newest first."""
    rows = registry.job_board.jobs(count=limit + 1, before=_rows_before(after))
    page_rows, following = _page(rows, after, limit, is_cut=True)
    return {"jobs": [_job_json(job) for job in page_rows], "next": following}


JobId = Annotated[str, Path(pattern=r"^[0-9a-f]{32}$")]


@routes.get("/jobs/{job_id}", response_model=answers.JobAnswer, responses=_error_responses(404), tags=["jobs"])
def job_of(registry: OpenRegistry, _: Viewer, job_id: JobId) -> dict[str, Any]:
    """Return the progress of a job, and its result at the end."""
    return _job_json(registry.job_board.job(job_id))


@routes.post(
    "/jobs/{job_id}/cancel",
    response_model=answers.JobAnswer,
    status_code=202,
    responses=_error_responses(404),
    tags=["jobs"],
)
def cancel(registry: OpenRegistry, _: Calibrator, job_id: JobId) -> dict[str, Any]:
    """Request a stop of a job; registered results stay. A finished job stays as it ended."""
    registry.job_board.cancel(job_id)
    return _job_json(registry.job_board.job(job_id))


@routes.get("/stations", response_model=answers.StationsAnswer, responses=_error_responses(400), tags=["stations"])
def stations(registry: OpenRegistry, _: Viewer, after: After = "", limit: Limit = 50) -> dict[str, Any]:
    """List the stations. Nothing here moves one: only the person at its line does."""
    page_rows, following = _page(stations_json(registry), after, limit)
    return {"stations": page_rows, "next": following}


@routes.get("/orders", response_model=answers.OrdersAnswer, responses=_error_responses(400), tags=["stations"])
def orders(
    registry: OpenRegistry,
    _: Viewer,
    station: Annotated[str | None, Query(pattern=r"^[^\x00]*$")] = None,
    after: After = "",
    limit: Limit = 50,
) -> dict[str, Any]:
    """List the orders to stations and how far they are, the newest first."""
    rows = registry.order_queue.runs(station, limit + 1, _rows_before(after))
    page_rows, following = _page(rows, after, limit, is_cut=True)
    return {"orders": [order_json(*run) for run in page_rows], "next": following}


@routes.get("/events", response_model=answers.EventsAnswer, responses=_error_responses(400), tags=["events"])
def events(
    registry: OpenRegistry,
    user: Viewer,
    after: After = "",
    kind: Annotated[list[Literal["verdict", "alert", "change"]], Query()] = ["verdict", "alert"],  # noqa: B006
    limit: Limit = 100,
) -> dict[str, Any]:
    """Return events in order. `change` covers the rest of the audit trail, for roles that may read it."""
    if CHANGE in kind:
        _require_permission("audit")(user)
    page = events_after(registry, cursor_of(after), limit, [name for name in KINDS if name in kind])
    return {
        "events": [event.to_json() for event in page.events],
        "next": cursor_text(page.cursor),
        "is_end": page.is_end,
    }


@routes.get("/alerts", response_model=answers.AlertsAnswer, responses=_error_responses(400), tags=["events"])
def alerts(registry: OpenRegistry, _: Viewer, after: After = "", limit: Limit = 50) -> dict[str, Any]:
    """List the alerts that are open; `softcal connect run` finds them."""
    page_rows, following = _page(list(open_alerts(registry).values()), after, limit)
    return {"alerts": page_rows, "next": following}


def _lot_json(registry: Registry, lot: Lot) -> dict[str, Any]:
    return {"lot": lot.id, **lot.settings(), "counts": registry.pages.verdict_counts(lot.id)}


def _unit(registry: Registry, lot_id: str, serial: str) -> Any:
    registry.lots.get(lot_id)
    unit = next(iter(registry.lots.units(lot_id, serial)), None)
    if unit is None:
        raise NoSuchUnit(f"serial {serial!r} is not in lot {lot_id!r}")
    return unit


def _job_json(job: Job) -> dict[str, Any]:
    values = {name: getattr(job, name) for name in ("job_id", "kind", "request", "actor", "fraction", "result")}
    return {
        **values,
        "created": job.created.isoformat(),
        "state": str(job.state),
        "message": render_message(job.message, partial(text, "en")) if job.message else "",
        "is_cancel_wanted": job.is_cancel_wanted,
        "is_lost": job.is_lost(datetime.now(UTC)),
    }
