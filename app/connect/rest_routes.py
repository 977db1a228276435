"""The REST answers: each one use case that commands and pages call, too."""

import hashlib
import io
import zipfile
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version
from typing import Annotated, Any, Literal
from unicodedata import normalize

from fastapi import APIRouter, Depends, Header, Path, Query, Request, Response
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer
from pydantic import AfterValidator
from starlette.exceptions import HTTPException

from softcal.app.connect import rest_models as answers
from softcal.app.connect.alert_watch import open_alerts
from softcal.app.connect.events import CHANGE, KINDS, events_after
from softcal.app.connect.stations import order_json, stations_json
from softcal.app.export.calibrated_unit import ExportOptions, UnitLoader
from softcal.app.export.certificates.laboratory import kept_laboratory
from softcal.app.export.formats import writer_of
from softcal.app.jobs import process
from softcal.app.registry.listing import history_json, unit_json
from softcal.app.texts.catalogue import text
from softcal.app.texts.reasons import told
from softcal.core.errors import InputError, NoSuchUnit
from softcal.core.lot import Lot, escape_serial
from softcal.core.orders import RunState
from softcal.core.unit.verdict import Release
from softcal.db.access.people import PERMISSIONS, may, permissions
from softcal.db.entries import User
from softcal.db.queues.job_board import Job
from softcal.db.queues.outbox import cursor_of, cursor_text
from softcal.db.registry import Registry
from softcal.db.truth.lot_pages import UnitFilter

MOST = 500
"""Rows of one answer at most."""

PARQUET = "application/vnd.apache.parquet"
BEARER = HTTPBearer(auto_error=False, description="a token of `softcal api token create`")
SIGN_IN = {"WWW-Authenticate": "Bearer"}
NAME = r"^[^\x00-\x1f\x7f/]{1,64}$"
LotId = Annotated[str, Path(pattern=NAME, description="id of a lot")]
Serial = Annotated[str, Path(pattern=NAME, description="serial of a unit"), AfterValidator(partial(normalize, "NFC"))]
Limit = Annotated[int, Query(ge=1, le=MOST, description="rows of one answer")]


def _registry(request: Request) -> Registry:
    registry: Registry = request.app.state.registry
    return registry


Known = Annotated[Registry, Depends(_registry)]


def _user(registry: Known, given: Annotated[HTTPAuthorizationCredentials | None, Depends(BEARER)]) -> User:
    if given is None:
        raise HTTPException(401, "sign in with a token: `Authorization: Bearer TOKEN`", SIGN_IN)
    try:
        return registry.tokens.user_of(given.credentials)
    except InputError as error:
        raise HTTPException(401, str(error), SIGN_IN) from error


SignedIn = Annotated[User, Depends(_user)]


def _needs(action: str) -> Callable[[User], User]:
    def check(user: SignedIn) -> User:
        if not may(user, action):
            roles = ", ".join(role for role, allowed in PERMISSIONS.items() if action in allowed)
            raise HTTPException(403, f"{user.role} may not do this; a token of {roles} may; nothing was changed")
        return user

    return check


Looking = Annotated[User, Depends(_needs("look"))]
Calibrating = Annotated[User, Depends(_needs("calibrate"))]


def _may_fail(*statuses: int) -> dict[int | str, dict[str, Any]]:
    return {status: {"model": answers.ProblemAnswer, "description": "one line that says why"} for status in statuses}


def _gives(media_type: str, what: str) -> dict[int | str, dict[str, Any]]:
    return {200: {"content": {media_type: {}}, "description": what}}


routes = APIRouter()


@routes.get("/me", response_model=answers.AccountAnswer, tags=["account"])
def me(user: SignedIn) -> dict[str, Any]:
    """Say whose token this is."""
    known = {"account": user.name, "role": user.role, "permissions": sorted(permissions(user))}
    return known | {"version": version("softcal")}


@routes.get("/lots", response_model=answers.LotPageAnswer, tags=["lots"])
def lots(registry: Known, _: Looking, after: str = "", limit: Limit = 50) -> dict[str, Any]:
    """List the lots by id."""
    behind = [lot_id for lot_id in registry.lots.ids() if lot_id > after]
    shown = behind[:limit]
    lots = [_lot_json(registry, registry.lots.get(lot_id)) for lot_id in shown]
    return {"lots": lots, "next": shown[-1] if len(behind) > limit else None}


@routes.get("/lots/{lot}", response_model=answers.LotAnswer, responses=_may_fail(404), tags=["lots"])
def lot_of(registry: Known, _: Looking, lot: LotId) -> dict[str, Any]:
    """Tell of one lot."""
    return _lot_json(registry, registry.lots.get(lot))


@routes.get("/lots/{lot}/release", response_model=answers.ReleaseAnswer, responses=_may_fail(404), tags=["lots"])
def release(registry: Known, _: Looking, lot: LotId) -> dict[str, Any]:
    """Say where a lot stands: what is released and by what, what waits, what was withdrawn. Nothing is decided anew."""
    from softcal.app.batch.release import lot_standing

    standing = lot_standing(registry, lot)
    return {"lot": lot, "release": None if standing.decided is None else standing.to_json()}


@routes.get("/lots/{lot}/units", response_model=answers.UnitPageAnswer, responses=_may_fail(404), tags=["units"])
def units(
    registry: Known,
    _: Looking,
    lot: LotId,
    verdict: Annotated[list[Literal[answers.Verdicts, "none"]], Query()] = [],  # noqa: B006
    text: Annotated[str, Query(pattern=r"^[^\x00]*$", description="serials that hold this text")] = "",
    sort: Literal["severity", "serial", "verdict", "made_at", "family", "predicted_rmse"] = "serial",
    descending: bool = False,
    page: Annotated[int, Query(ge=1, le=10**6)] = 1,
    limit: Limit = 50,
) -> dict[str, Any]:
    """List the target units of a lot with their verdicts, filtered and sorted."""
    rows = registry.pages.unit_page(lot, UnitFilter(tuple(verdict), text, sort, descending), page, limit)
    following = page + 1 if page * limit < rows.total else None
    return {"units": [unit_json(unit) for unit in rows.units], "total": rows.total, "next": following}


@routes.get("/lots/{lot}/units/{serial}", response_model=answers.UnitAnswer, responses=_may_fail(404), tags=["units"])
def unit_of_lot(registry: Known, _: Looking, lot: LotId, serial: Serial) -> dict[str, Any]:
    """Tell of one unit of a lot."""
    return unit_json(_unit(registry, lot, serial))


@routes.get(
    "/lots/{lot}/units/{serial}/revisions",
    response_model=answers.RevisionsAnswer,
    responses=_may_fail(404),
    tags=["units"],
)
def revisions(registry: Known, _: Looking, lot: LotId, serial: Serial) -> dict[str, Any]:
    """Tell every calibration of a unit, and which one is in use."""
    _unit(registry, lot, serial)
    history = [history_json(stored) for stored in registry.calibrations.history(serial, lot)]
    return {"lot": lot, "serial": serial, "revisions": history}


@routes.get(
    "/lots/{lot}/units/{serial}/files/{format}",
    response_class=Response,
    responses=_gives("application/zip", "its files as one archive") | _may_fail(400, 404, 409),
    tags=["files"],
)
def files(
    registry: Known,
    user: Calibrating,
    lot: LotId,
    serial: Serial,
    format: Annotated[str, Path(pattern=r"^[A-Za-z0-9_-]{1,32}$", description="json, c, blob, hex, onnx, pdf, dcc")],
    conditional: Annotated[bool, Query(description="conditional units have their files, too")] = False,
) -> Response:
    """Give the calibration files of a unit with their manifest; a unit that is not released is refused (409)."""
    _unit(registry, lot, serial)
    release = Release.CONDITIONAL if conditional else Release.PASS
    options = ExportOptions(release=release, lot_id=lot, laboratory=kept_laboratory())
    contents = writer_of(format)(UnitLoader(registry, options).load(serial))
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in contents.items():
            archive.writestr(zipfile.ZipInfo(name), content)
    registry.trail.add("export", "units", (serial,), {"lot_id": lot, "formats": [format]}, actor=user.name)
    name = f"{escape_serial(serial)}-{format}.zip"
    return Response(
        packed.getvalue(), 200, {"content-disposition": f'attachment; filename="{name}"'}, "application/zip"
    )


@routes.get(
    "/lots/{lot}/results.parquet",
    response_class=Response,
    responses=_gives(PARQUET, "a row a unit") | _may_fail(404),
    tags=["files"],
)
def results(registry: Known, _: Looking, lot: LotId) -> Response:
    """Give the results of a lot as Parquet, a row a unit."""
    from softcal.app.batch.results import lot_results, parquet_bytes

    content = parquet_bytes(lot_results(registry, lot))
    return Response(content, 200, media_type=PARQUET)


@routes.get("/units/{serial}", response_model=answers.UnitsAnswer, responses=_may_fail(404), tags=["units"])
def unit(registry: Known, _: Looking, serial: Serial) -> dict[str, Any]:
    """Tell of a serial in every lot it stands in."""
    return {"units": [unit_json(unit) for unit in registry.lots.units(serial=serial)]}


@routes.post(
    "/jobs", response_model=answers.JobAnswer, status_code=202, responses=_may_fail(400, 404, 409), tags=["jobs"]
)
def start(
    registry: Known,
    user: Calibrating,
    wanted: answers.JobRequest,
    response: Response,
    idempotency_key: Annotated[
        str | None, Header(pattern=r"^[\x21-\x7e]{1,255}$", description="the same key again is the same job")
    ] = None,
) -> dict[str, Any]:
    """Start a batch over a lot. Ask the job how far it is; a key makes it safe to ask twice."""
    registry.lots.get(wanted.lot)
    request, board = {"lot": wanted.lot}, registry.job_board
    job_id = None
    if idempotency_key is not None:
        job_id = hashlib.sha256(f"{user.name}\n{idempotency_key}".encode()).hexdigest()[:32]
    known = None if job_id is None else board.find(job_id)
    if known is not None and (known.kind, known.request) != (wanted.kind, request):
        raise HTTPException(409, "this Idempotency-Key was given for another request; give a new one; nothing was done")
    placed = known.job_id if known is not None else board.place(wanted.kind, request, user.name, job_id)
    job = board.job(placed)
    if known is None or (job.state is RunState.QUEUED and job.is_lost(datetime.now(UTC))):
        process.launch(placed)
    response.headers["location"] = f"/v1/jobs/{placed}"
    return _job_json(job)


@routes.get("/jobs", response_model=answers.JobsAnswer, tags=["jobs"])
def jobs(registry: Known, _: Looking, limit: Limit = 50) -> dict[str, Any]:
    """List the newest jobs."""
    return {"jobs": [_job_json(job) for job in registry.job_board.jobs(count=limit)]}


JobId = Annotated[str, Path(pattern=r"^[0-9a-f]{32}$")]


@routes.get("/jobs/{job_id}", response_model=answers.JobAnswer, responses=_may_fail(404), tags=["jobs"])
def job_of(registry: Known, _: Looking, job_id: JobId) -> dict[str, Any]:
    """Tell how far a job is, and its result once it is done."""
    return _job_json(_job(registry, job_id))


@routes.post(
    "/jobs/{job_id}/cancel", response_model=answers.JobAnswer, status_code=202, responses=_may_fail(404), tags=["jobs"]
)
def cancel(registry: Known, _: Calibrating, job_id: JobId) -> dict[str, Any]:
    """Ask a job to stop; what it has registered stays. One that is over stays as it ended."""
    _job(registry, job_id)
    registry.job_board.cancel(job_id)
    return _job_json(registry.job_board.job(job_id))


@routes.get("/stations", response_model=answers.StationsAnswer, tags=["stations"])
def stations(registry: Known, _: Looking) -> dict[str, Any]:
    """List the stations. Nothing here moves one: only the person at its line does."""
    return {"stations": stations_json(registry)}


@routes.get("/orders", response_model=answers.OrdersAnswer, tags=["stations"])
def orders(
    registry: Known, _: Looking, station: Annotated[str | None, Query(pattern=r"^[^\x00]*$")] = None, limit: Limit = 50
) -> dict[str, Any]:
    """List the newest orders to stations and how far they are."""
    return {"orders": [order_json(*run) for run in registry.order_queue.runs(station, limit)]}


@routes.get("/events", response_model=answers.EventsAnswer, responses=_may_fail(400), tags=["events"])
def events(
    registry: Known,
    user: Looking,
    after: Annotated[str, Query(max_length=2000, description="`next` of the last answer; nothing begins")] = "",
    kind: Annotated[list[Literal["verdict", "alert", "change"]], Query()] = ["verdict", "alert"],  # noqa: B006
    limit: Limit = 100,
) -> dict[str, Any]:
    """Give events in their order. `change` is the rest of the audit trail, for who may read it."""
    if CHANGE in kind:
        _needs("audit")(user)
    page = events_after(registry, cursor_of(after), limit, [name for name in KINDS if name in kind])
    return {
        "events": [event.to_json() for event in page.events],
        "next": cursor_text(page.cursor),
        "is_end": page.is_end,
    }


@routes.get("/alerts", response_model=answers.AlertsAnswer, tags=["events"])
def alerts(registry: Known, _: Looking) -> dict[str, Any]:
    """List the alerts that are open; `softcal connect run` finds them."""
    return {"alerts": list(open_alerts(registry).values())}


def _lot_json(registry: Registry, lot: Lot) -> dict[str, Any]:
    return {"lot": lot.id, **lot.settings(), "counts": registry.pages.verdict_counts(lot.id)}


def _unit(registry: Registry, lot_id: str, serial: str) -> Any:
    registry.lots.get(lot_id)
    unit = next(iter(registry.lots.units(lot_id, serial)), None)
    if unit is None:
        raise NoSuchUnit(f"serial {serial!r} is not in lot {lot_id!r}")
    return unit


def _job(registry: Registry, job_id: str) -> Job:
    return registry.job_board.job(job_id)


def _job_json(job: Job) -> dict[str, Any]:
    plain = {name: getattr(job, name) for name in ("job_id", "kind", "request", "actor", "fraction", "result")}
    return {
        **plain,
        "created": job.created.isoformat(),
        "state": str(job.state),
        "message": told(job.message, partial(text, "en")) if job.message else "",
        "is_cancel_wanted": job.is_cancel_wanted,
        "is_lost": job.is_lost(datetime.now(UTC)),
    }
