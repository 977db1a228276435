"""The REST application: its errors, its OpenAPI document, and its server, local or encrypted."""

import json
import os
import ssl
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import uvicorn
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.openapi.utils import get_openapi
from fastapi.responses import JSONResponse, Response
from starlette.exceptions import HTTPException

from softcal.app.bootstrap import REGISTRY_VARIABLE, open_chosen_registry, registry_url
from softcal.app.connect.settings import is_local
from softcal.app.jobs.runner import JobRunner
from softcal.app.logs import log_crash
from softcal.app.rest.middleware import MAX_HEAD, BoundedProtocol, RequestGuard
from softcal.app.rest.problem import PROBLEM, TITLES, problem
from softcal.app.rest.routes import routes
from softcal.app.rest.v1 import ProblemAnswer
from softcal.core.errors import InputError, NotInRegistry, RegistryError, SoftcalError, UnitRefused
from softcal.db.queues.job_board import QueueFull
from softcal.db.registry import Registry

COMMON_STATUSES = (400, 401, 403, 408, 413, 422, 503)
"""Errors that any answer may be."""

IF_NONE_MATCH = {
    "name": "If-None-Match",
    "in": "header",
    "required": False,
    "description": "`ETag` of an answer that the asker has",
    "schema": {"type": "string", "maxLength": 1000},
}

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
        openapi_url=None,
        responses={status: {"model": ProblemAnswer, "description": TITLES[status]} for status in COMMON_STATUSES},
    )
    app.state.registry, app.state.jobs = registry, JobRunner(registry)
    app.add_middleware(RequestGuard, user_of=registry.tokens.user_of, hosts=hosts)
    app.include_router(routes, prefix="/v1")
    for kind in (SoftcalError, RequestValidationError, HTTPException, Exception):
        app.add_exception_handler(kind, _answer)

    @app.get("/health", include_in_schema=False)
    def health() -> dict[str, str]:
        """Return that the server answers; open to everybody, without further data."""
        return {"status": "ok"}

    app.openapi = lambda: openapi_document(app)  # type: ignore[method-assign]
    document = cache(lambda: json.dumps(app.openapi()).encode())

    @app.get("/openapi.json", include_in_schema=False)
    def openapi() -> Response:
        """Return the document; open to everybody, and so not written anew for each."""
        return Response(document(), media_type="application/json")

    return app


def openapi_document(app: FastAPI) -> dict[str, Any]:
    """Return the OpenAPI document, built once."""
    if app.openapi_schema is None:
        document = get_openapi(title=app.title, version=app.version, description=app.description, routes=app.routes)
        for path in document["paths"].values():
            if "get" in path:
                path["get"].setdefault("parameters", []).append(IF_NONE_MATCH)
                path["get"]["responses"]["304"] = {"description": "the asker has this answer already"}
            for operation in path.values():
                for status, answer in operation["responses"].items():
                    if status[0] in "45" and "application/json" in answer.get("content", {}):
                        answer["content"] = {PROBLEM: answer["content"]["application/json"]}
        app.openapi_schema = document
    return app.openapi_schema


def _answer(_: Request, error: Exception) -> JSONResponse:
    """Return a request's error as one line; what softcal raises on purpose is no defect."""
    match error:
        case QueueFull():
            return problem(429, str(error))
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
    """Settings of the API server.

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
        if self.cert_file is None and not is_local(self.host):
            raise InputError(
                f"--host {self.host}: other machines would send their tokens readable for all; give --cert and --key, "
                "or stay at 127.0.0.1 behind a proxy that encrypts"
            )
        for file in (self.cert_file, self.key_file):
            if file is not None and not file.is_file():
                raise InputError(f"{file}: there is no such file")


def serve_api(options: ServingOptions, on_first_write: Callable[[str], None]) -> None:
    """Serve until Ctrl-C; `on_first_write` gets the registry's URL after the first write.

    `InputError`: unusable address. `RegistryError`: the registry cannot be opened.
    """
    url, protocol = registry_url(options.registry), _protocol(options)
    # A job is a process of its own; it finds the registry there.
    os.environ[REGISTRY_VARIABLE] = url
    with open_chosen_registry(url) as registry:
        registry.database.on_first_write = lambda: on_first_write(url)
        app = rest_app(registry, ("127.0.0.1", "localhost", options.host, *options.names))
        app.state.jobs.adopt()
        config = uvicorn.Config(
            app,
            options.host,
            options.port,
            log_level="warning",
            server_header=False,
            http=protocol,
            ws="none",
            h11_max_incomplete_event_size=MAX_HEAD,
        )
        server = uvicorn.Server(config)
        try:
            server.run()
        except SystemExit as end:
            raise InputError(f"nobody can listen at {options.host}:{options.port}; is the port taken?") from end


def _protocol(options: ServingOptions) -> type[BoundedProtocol]:
    if options.cert_file is None:
        return BoundedProtocol
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        context.load_cert_chain(options.cert_file, options.key_file)
    except OSError as error:
        raise InputError(f"certificate {options.cert_file} with its key cannot be read: {error}") from error
    return type("EncryptedProtocol", (BoundedProtocol,), {"tls_context": context})
