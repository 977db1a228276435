"""The REST application: who asks, what goes wrong, and the OpenAPI document. The answers are in `rest_routes`."""

from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.openapi.utils import get_openapi
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.middleware.trustedhost import TrustedHostMiddleware

from softcal.app.connect.rest_models import ProblemAnswer
from softcal.app.connect.rest_routes import routes
from softcal.app.logs import log_crash
from softcal.core.errors import InputError, RegistryError, SoftcalError, UnitRefused
from softcal.db.registry import Registry

PROBLEM = "application/problem+json"
TITLES = {
    400: "Bad request",
    401: "Not signed in",
    403: "Not allowed",
    404: "Not found",
    405: "Method not allowed",
    409: "Conflict",
    422: "Invalid request",
    500: "Defect",
    503: "Registry away",
}
EVERYWHERE = (401, 403, 422, 503)
"""Errors that any answer may be."""

DESCRIPTION = """Units, verdicts, files, lots, jobs, stations and events of a softcal registry.

Sign in with a token of `softcal api token create`: `Authorization: Bearer TOKEN`. It may do what the role of its
account may. Every error is one line of `application/problem+json`.
"""


def rest_app(registry: Registry, hosts: Sequence[str] = ("127.0.0.1", "localhost", "testserver")) -> FastAPI:
    """Return the application over an open registry.

    Args:
        hosts: names under which it may be asked; another one in a request's Host is refused.
    """
    app = FastAPI(
        title="softcal",
        version=version("softcal"),
        description=DESCRIPTION,
        docs_url=None,  # Its page loads scripts from elsewhere; a plant has no internet.
        redoc_url=None,
        responses={status: {"model": ProblemAnswer, "description": TITLES[status]} for status in EVERYWHERE},
    )
    app.state.registry = registry
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=list(hosts), www_redirect=False)
    app.include_router(routes, prefix="/v1")
    app.add_exception_handler(SoftcalError, _softcal_error)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(HTTPException, _http_error)
    app.add_exception_handler(Exception, _defect)

    @app.get("/health", include_in_schema=False)
    def health() -> dict[str, str]:
        """Say that the server answers; open to everybody, and tells nothing else."""
        return {"status": "ok"}

    app.openapi = lambda: openapi_document(app)  # type: ignore[method-assign]
    return app


def openapi_document(app: FastAPI) -> dict[str, Any]:
    """Return the OpenAPI document; made once."""
    if app.openapi_schema is None:
        made = get_openapi(title=app.title, version=app.version, description=app.description, routes=app.routes)
        for path in made["paths"].values():
            for operation in path.values():
                for status, answer in operation["responses"].items():
                    if status[0] in "45" and "application/json" in answer.get("content", {}):
                        answer["content"] = {PROBLEM: answer["content"]["application/json"]}
        app.openapi_schema = made
    return app.openapi_schema


def problem(status: int, detail: str, headers: Any = None) -> JSONResponse:
    """Return an error as RFC 9457 writes it."""
    told = ProblemAnswer(title=TITLES.get(status, "Error"), status=status, detail=detail)
    return JSONResponse(told.model_dump(), status, headers, PROBLEM)


def _softcal_error(_: Request, error: Exception) -> JSONResponse:
    return problem(status_of(error), str(error))


def status_of(error: Exception) -> int:
    """Return the status of what softcal raises on purpose."""
    if isinstance(error, RegistryError):
        return 503
    if isinstance(error, UnitRefused):
        return 409
    is_unknown = isinstance(error, InputError) and error.reason.code.startswith("name.no_")
    return 404 if is_unknown else 400


def _invalid(_: Request, error: Exception) -> JSONResponse:
    if not isinstance(error, RequestValidationError):
        raise error
    first = error.errors()[0]
    return problem(422, f"{'.'.join(str(part) for part in first['loc'])}: {first['msg']}")


def _http_error(_: Request, error: Exception) -> JSONResponse:
    if not isinstance(error, HTTPException):
        raise error
    return problem(error.status_code, str(error.detail), error.headers)


def _defect(_: Request, error: Exception) -> JSONResponse:
    return problem(500, log_crash(error, "api"))
