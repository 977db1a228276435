"""Serves the REST application: on this machine alone, or encrypted."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import uvicorn

from softcal.app.bootstrap import REGISTRY_VARIABLE, open_chosen_registry, registry_url
from softcal.app.connect.rest import rest_app
from softcal.app.connect.settings import is_here
from softcal.core.errors import InputError


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
    """Serve until Ctrl-C.

    Args:
        on_first_write: told the registry's URL once something was written to it.

    Raises:
        InputError: nobody can listen there.
        RegistryError: the registry cannot be opened.
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
