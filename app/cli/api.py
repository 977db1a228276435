"""`softcal api`: the REST interface, and tokens by which programs sign in."""

import argparse
import json
from typing import TYPE_CHECKING, Any

from softcal.app.cli.options import (
    COUNT,
    FILE,
    actions_of,
    add_shared,
    answer,
    echo_written_url,
    registry_at,
    registry_of,
)
from softcal.app.files.atomic import write_text
from softcal.app.output import echo, print_table

if TYPE_CHECKING:
    from softcal.db.entries import Token

EXAMPLES = """examples:
  softcal api token create --account MES --purpose "MES of hall 3" --days 365
  softcal api serve
  softcal api serve --host 0.0.0.0 --name softcal.plant --cert server.pem --key server.key
  softcal api token list
  softcal api token withdraw 3f2a9c0b1d4e --reason "MES was replaced"
  softcal api openapi --out openapi.json
  softcal api client --out softcal_client.py

A token may do what the role of its account may; `softcal account` makes accounts.
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Units, verdicts, files, lots, jobs and events for other programs, over HTTP."""
    action = actions_of(parser)
    serve = action("serve", "serve the REST interface until Ctrl-C", _serve)
    add_shared(serve, "registry")
    add = serve.add_argument
    add("--host", default="127.0.0.1", help="address to listen at; default: this machine only")
    add("--port", type=int, default=8600, help="default 8600")
    add("--name", action="append", default=[], help="another name under which programs reach this server; repeatable")
    add("--cert", **FILE, help="certificate of the server, PEM")
    add("--key", **FILE, help="its private key, PEM")
    openapi = action("openapi", "write the OpenAPI document", _openapi)
    openapi.add_argument("--out", required=True, **FILE)
    client = action("client", "write a typed Python client: one file, standard library alone", _client)
    client.add_argument("--out", required=True, **FILE)
    token = actions_of(action("token", "make, list and withdraw tokens", None))
    create = token("create", "make a token; it is shown once", _create)
    create.add_argument("--account", required=True, metavar="NAME", help="whose role says what it may")
    create.add_argument("--purpose", required=True, metavar="TEXT", help="which program it is for")
    create.add_argument("--days", default=365, **COUNT, help="how long it holds; default 365")
    listing = token("list", "all tokens, without their secrets", _list)
    add_shared(listing, "csv")
    withdraw = token("withdraw", "make a token useless from now on", _withdraw)
    withdraw.add_argument("token", metavar="ID")
    add_shared(withdraw, "reason")
    for each in (create, listing, withdraw):
        add_shared(each, "registry", "json")


def _serve(options: argparse.Namespace) -> None:
    from softcal.app.rest.server import ServingOptions, serve_api

    serving = ServingOptions(
        options.registry, options.host, options.port, tuple(options.name), options.cert, options.key
    )
    scheme = "http" if options.cert is None else "https"
    echo(f"the REST interface is at {scheme}://{options.host}:{options.port}/v1; Ctrl-C ends it")
    serve_api(serving, echo_written_url)


def _openapi(options: argparse.Namespace) -> None:
    write_text(options.out, json.dumps(_document(), indent=2) + "\n")


def _client(options: argparse.Namespace) -> None:
    from softcal.app.rest.client_text import client_text

    write_text(options.out, client_text(_document()))


def _document() -> dict[str, Any]:
    from softcal.app.rest.server import openapi_document, rest_app

    with registry_at("sqlite://") as registry:
        return openapi_document(rest_app(registry))


def _create(options: argparse.Namespace) -> None:
    with registry_of(options) as registry:
        token, secret = registry.tokens.add(options.account, options.purpose, options.days)
    if answer(options, "api.token/1", {**_token_json(token), "token": secret}):
        print(secret)
        until = token.ends_at.astimezone()
        echo(f"token {token.token_id} of {token.account} holds until {until:%Y-%m-%d}; it is not shown again")


def _list(options: argparse.Namespace) -> None:
    with registry_of(options) as registry:
        tokens, now = registry.tokens.all(), registry.settings.clock()
    answer(options, "api.tokens/1", {"tokens": [_token_json(each) for each in tokens]})
    rows = []
    for token in tokens:
        created, until = f"{token.created.astimezone():%Y-%m-%d}", f"{token.ends_at.astimezone():%Y-%m-%d}"
        holds = "yes" if token.holds(now) else "no"
        rows.append((token.token_id, token.account, token.purpose, created, until, holds))
    print_table(("token", "account", "purpose", "made", "until", "holds"), rows)


def _withdraw(options: argparse.Namespace) -> None:
    with registry_of(options) as registry:
        registry.tokens.withdraw(options.token, reason=options.reason)
    if answer(options, "api.withdrawn/1", {"token_id": options.token}):
        print(f"token {options.token} was withdrawn; what it was used for until now stands in the audit trail")


def _token_json(token: "Token") -> dict[str, object]:
    return vars(token) | {"created": token.created.isoformat(), "ends_at": token.ends_at.isoformat()}
