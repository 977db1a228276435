"""The REST application: its errors, its OpenAPI document, and its server, local or encrypted."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import uvicorn
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.openapi.utils import get_openapi
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.middleware.trustedhost import TrustedHostMiddleware

from softcal.app.bootstrap import REGISTRY_VARIABLE, open_chosen_registry, registry_url
from softcal.app.connect.rest_models import ProblemAnswer
from softcal.app.connect.rest_routes import routes
from softcal.app.connect.settings import is_here
from softcal.app.logs import log_crash
from softcal.core.errors import InputError, NotInRegistry, RegistryBusy, RegistryError, SoftcalError, UnitRefused
from softcal.db.registry import Registry

PROBLEM = "application/problem+json"
RETRY_AFTER_S = 5
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
    """Return the application over an open registry; a Host in a request that is none of `hosts` is refused."""
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
    for kind in (SoftcalError, RequestValidationError, HTTPException, Exception):
        app.add_exception_handler(kind, _answer)

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
    answer = ProblemAnswer(title=TITLES.get(status, "Error"), status=status, detail=detail)
    return JSONResponse(answer.model_dump(), status, headers, PROBLEM)


def _answer(_: Request, error: Exception) -> JSONResponse:
    """Return a request's error as one line; what softcal raises on purpose is no defect."""
    match error:
        case RegistryBusy():
            return problem(503, str(error), {"retry-after": str(RETRY_AFTER_S)})
        case RegistryError():
            return problem(503, str(error))
        case UnitRefused():
            return problem(409, str(error))
        case NotInRegistry():
            return problem(404, str(error))
        case SoftcalError():
            return problem(400, str(error))
        case RequestValidationError():
            first = error.errors()[0]
            return problem(422, f"{'.'.join(str(part) for part in first['loc'])}: {first['msg']}")
        case HTTPException():
            return problem(error.status_code, str(error.detail), error.headers)
    return problem(500, log_crash(error, "api"))


@dataclass(frozen=True)
class ServingOptions:
    """How the API is served.

    Args:
        registry: URL of the registry; None takes the default.
        names: other names under which programs reach this server, as behind a proxy.
        cert_file, key_file: of the server; needed where other machines reach it.
    """

    registry: str | None = None
    host: str = "127.0.0.1"
    port: int = 8600
    names: tuple[str, ...] = ()
    cert_file: Path | None = None
    key_file: Path | None = None

    def __post_init__(self) -> None:
        if (self.cert_file is None) != (self.key_file is None):
            raise InputError("--cert and --key belong together")
        if self.cert_file is None and not is_here(self.host):
            raise InputError(
                f"--host {self.host}: other machines would send their tokens readable for all; give --cert and --key, "
                "or stay at 127.0.0.1 behind a proxy that encrypts"
            )
        for file in (self.cert_file, self.key_file):
            if file is not None and not file.is_file():
                raise InputError(f"{file}: there is no such file")


def serve_api(options: ServingOptions, on_first_write: Callable[[str], None]) -> None:
    """Serve until Ctrl-C; `on_first_write` gets the registry's URL once something was written to it.

    `InputError`: nobody can listen there. `RegistryError`: the registry cannot be opened.
    """
    url = registry_url(options.registry)
    # A job is a process of its own; it finds the registry there.
    os.environ[REGISTRY_VARIABLE] = url
    with open_chosen_registry(url) as registry:
        registry.database.on_first_write = lambda: on_first_write(url)
        app = rest_app(registry, ("127.0.0.1", "localhost", options.host, *options.names))
        config = uvicorn.Config(
            app,
            options.host,
            options.port,
            log_level="warning",
            server_header=False,
            ssl_certfile=options.cert_file,
            ssl_keyfile=options.key_file,
        )
        server = uvicorn.Server(config)
        try:
            server.run()
        except SystemExit as end:
            raise InputError(f"nobody can listen at {options.host}:{options.port}; is the port taken?") from end
