"""`softcal connect`: events to webhooks, mail and MQTT, an OPC UA server, and live estimates."""

import argparse
import signal
import sys
import threading

from softcal.app.cli.options import FILE, actions_of, add_shared, answer, positive, registry_of
from softcal.app.output import echo, print_table
from softcal.core.errors import InputError
from softcal.core.lot import UnitKey

EXAMPLES = """examples:
  softcal connect secret --out mes.secret               a secret for the signature of a webhook
  softcal connect check plant.toml                      read the file, reach every destination
  softcal connect run plant.toml                        until Ctrl-C
  softcal connect status                                how far every destination is, and what is wrong
  softcal adapt --serial A1 - --out - | softcal connect estimates plant.toml --lot lot-1 --serial A1
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Send events to other programs and people, each at least once, across restarts of both sides."""
    action = actions_of(parser)
    run = action("run", "serve every destination of a file until Ctrl-C", _run)
    run.add_argument("file", **FILE, help="TOML with the destinations")
    add_shared(run, "registry")
    check = action("check", "read the file and reach every destination once; nothing is sent", _check)
    check.add_argument("file", **FILE, help="TOML with the destinations")
    status = action("status", "how far every destination is", _status)
    add_shared(status, "registry", "json", "csv")
    secret = action("secret", "write a new secret for the signature of a webhook", _secret)
    secret.add_argument("--out", required=True, **FILE, help="new file; only its owner may read it")
    estimates = action("estimates", "publish live estimates from standard input over MQTT", _estimates)
    add = estimates.add_argument
    add("file", **FILE, help="TOML with one [[mqtt]] destination")
    add("--lot", required=True, metavar="ID", help="lot of the unit")
    add("--serial", required=True, metavar="S")
    add("--rate", type=positive, default=10.0, metavar="HZ", help="rows a second at most; default 10")


def _run(options: argparse.Namespace) -> None:
    from softcal.app.connect.service import run_connect
    from softcal.app.connect.settings import read_settings

    settings, stop = read_settings(options.file), threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    signal.signal(signal.SIGINT, lambda *_: stop.set())
    with registry_of(options) as registry:
        echo(f"{options.file}: events are sent; Ctrl-C ends it, and what waits is kept")
        run_connect(registry, settings, stop, echo)


def _check(options: argparse.Namespace) -> None:
    from softcal.app.connect.service import check_destinations
    from softcal.app.connect.settings import read_settings

    for name in check_destinations(read_settings(options.file)):
        print(f"{name}: reached")


def _status(options: argparse.Namespace) -> None:
    from softcal.app.connect.forwarder import status_json

    with registry_of(options) as registry:
        status = status_json(registry, registry.settings.clock())
    answer(options, "connect.status/1", {"destinations": status})
    rows = [list(delivery.values()) for delivery in status]
    print_table(("destination", "sent", "waits", "failed", "next try", "why", "served by"), rows)


def _secret(options: argparse.Namespace) -> None:
    from softcal.app.connect.webhook import write_new_secret

    write_new_secret(options.out)
    print(f"{options.out}: give its first line to whoever receives the webhook")


def _estimates(options: argparse.Namespace) -> None:
    from softcal.app.connect.mqtt import publish_estimates
    from softcal.app.connect.settings import read_settings

    mqtts = read_settings(options.file).mqtts
    if len(mqtts) != 1:
        raise InputError(f"{options.file}: one [[mqtt]] was expected, there are {len(mqtts)}")
    published, skipped = publish_estimates(sys.stdin, UnitKey(options.lot, options.serial), mqtts[0], options.rate)
    echo(f"{published} estimates were published, {skipped} were left out")
