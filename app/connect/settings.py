"""Destinations of events in one TOML file; each secret is in a separate file."""

import ipaddress
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, TypeVar
from urllib.parse import SplitResult, urlsplit

from softcal.app.connect.events import KINDS
from softcal.app.files.toml_file import check_names, read_section, read_toml
from softcal.app.texts.catalogue import LANGUAGES
from softcal.core.errors import InputError

BEGINNINGS = ("now", "first")
"""Where a new destination begins: with what happens from now on, or with the first event."""


@dataclass(frozen=True, kw_only=True)
class DestinationSettings:
    """Settings of every destination.

    Args:
        name: its name, under which its cursor is stored.
        events: which kinds it gets: verdict, alert, change.
        begin: `now` or `first`: where it begins when it is new.
        ca_file: certificates to trust in place of the system's.
        timeout_s: how long one answer or confirmation may take.
    """

    name: str
    events: tuple[str, ...] = ("verdict", "alert")
    begin: str = "now"
    ca_file: Path | None = None
    timeout_s: float = 10.0

    section: ClassVar[str] = ""

    def __post_init__(self) -> None:
        if not 0 < len(self.name) <= 64 or not self.name.isprintable():
            raise InputError("name must have 1 to 64 printable characters")
        check_names("events", self.events, KINDS)
        check_names("begin", (self.begin,), BEGINNINGS)
        _check_positive("timeout_s", self.timeout_s)


@dataclass(frozen=True, kw_only=True)
class WebhookSettings(DestinationSettings):
    """An HTTP address that gets each event as a signed POST.

    Args:
        url: https://..., or http://... on this machine.
        secret_file: holds the secret of the signature, as `softcal connect secret` writes it.
    """

    url: str
    secret_file: Path

    section = "webhook"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_address("url", self.url, ("https",), ("http",))


@dataclass(frozen=True, kw_only=True)
class MailSettings(DestinationSettings):
    """A mail server that sends events to people, what waits together as one mail.

    Args:
        server: smtps://USER@HOST:465, smtp+starttls://USER@HOST:587, or smtp://HOST:25 on this machine.
        password_file: holds the password of USER.
        sender, to: addresses.
        language: of the mails: en or ko.
    """

    server: str
    sender: str
    to: tuple[str, ...]
    events: tuple[str, ...] = ("alert",)
    password_file: Path | None = None
    language: str = "en"
    timeout_s: float = 30.0

    section = "mail"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_address("server", self.server, ("smtps", "smtp+starttls"), ("smtp",))
        check_names("language", (self.language,), tuple(LANGUAGES))
        for address in (self.sender, *self.to):
            if address.count("@") != 1 or not address.isprintable() or any(c in address for c in " <>,;"):
                raise InputError(f"{address!r} is no mail address")
        if not self.to:
            raise InputError("to names nobody")


@dataclass(frozen=True, kw_only=True)
class MqttSettings(DestinationSettings):
    """A broker that gets events, the state of every unit and station, and live estimates.

    Args:
        broker: mqtts://USER@HOST:8883, or mqtt://HOST:1883 on this machine.
        topic: what all topics begin with.
        password_file: holds the password of USER.
        cert_file, key_file: of this client, where the broker asks for one.
    """

    broker: str
    topic: str = "softcal"
    password_file: Path | None = None
    cert_file: Path | None = None
    key_file: Path | None = None
    timeout_s: float = 20.0

    section = "mqtt"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_address("broker", self.broker, ("mqtts",), ("mqtt",))
        if not self.topic or any(c in self.topic for c in "+#\0") or self.topic.startswith(("/", "$")):
            raise InputError(f"topic {self.topic!r}: a plain topic such as plant-1/softcal was expected")
        if (self.cert_file is None) != (self.key_file is None):
            raise InputError("cert_file and key_file belong together")


@dataclass(frozen=True, kw_only=True)
class OpcUaSettings:
    """The OPC UA server.

    Args:
        endpoint: opc.tcp://HOST:PORT/PATH; other machines than this one reach it only with a certificate.
        cert_file, key_file: of the server; with them clients sign in with an account and its token.
        every_s: seconds between two looks at the registry.
    """

    endpoint: str = "opc.tcp://127.0.0.1:4840/softcal"
    cert_file: Path | None = None
    key_file: Path | None = None
    every_s: float = 0.5

    def __post_init__(self) -> None:
        parts = split_address("endpoint", self.endpoint)
        if parts.scheme != "opc.tcp" or not parts.port:
            raise InputError(f"endpoint {self.endpoint!r}: opc.tcp://HOST:PORT/PATH was expected")
        if (self.cert_file is None) != (self.key_file is None):
            raise InputError("cert_file and key_file belong together")
        if self.cert_file is None and not is_local(parts.hostname or ""):
            raise InputError(
                f"endpoint {self.endpoint}: other machines would reach it without sign-in; give cert_file and "
                "key_file, or 127.0.0.1"
            )
        _check_positive("every_s", self.every_s)


@dataclass(frozen=True)
class AlertSettings:
    """Interval between checks for alerts in seconds, 0 for no checks."""

    every_s: float = 30.0

    def __post_init__(self) -> None:
        if not 0 <= self.every_s < 1e6:
            raise InputError("every_s: seconds were expected, 0 for no alerts")


@dataclass(frozen=True)
class ConnectSettings:
    """All destinations of a file; without `opcua` no server, with `alerts_every_s` 0 no checks for alerts."""

    webhooks: tuple[WebhookSettings, ...] = ()
    mails: tuple[MailSettings, ...] = ()
    mqtts: tuple[MqttSettings, ...] = ()
    opcua: OpcUaSettings | None = None
    alerts_every_s: float = 30.0


Destination = TypeVar("Destination", bound=DestinationSettings)


def read_settings(path: Path) -> ConnectSettings:
    """Read a file of destinations.

    `InputError`: it cannot be read, names something unknown, or two destinations have one name.
    """
    content = read_toml(path)
    check_names(f"{path}: section", content, ("webhook", "mail", "mqtt", "opcua", "alerts"))
    alerts = read_section(f"{path}: [alerts]", AlertSettings, content.get("alerts", {}))
    opcua = content.get("opcua")
    settings = ConnectSettings(
        tuple(_sections(path, WebhookSettings, content)),
        tuple(_sections(path, MailSettings, content)),
        tuple(_sections(path, MqttSettings, content)),
        None if opcua is None else read_section(f"{path}: [opcua]", OpcUaSettings, opcua, path.parent),
        alerts.every_s,
    )
    names = [one.name for one in (*settings.webhooks, *settings.mails, *settings.mqtts)]
    if twice := {name for name in names if names.count(name) > 1}:
        raise InputError(f"{path}: two destinations are called {min(twice)!r}; each needs a name of its own")
    return settings


def _sections(path: Path, kind: type[Destination], content: Mapping[str, Any]) -> list[Destination]:
    tables = content.get(kind.section, [])
    if not isinstance(tables, list):
        raise InputError(f"{path}: write [[{kind.section}]] with two brackets: there may be several")
    return [read_section(f"{path}: [{kind.section}]", kind, table, path.parent) for table in tables]


def _check_positive(name: str, value: float) -> None:
    if not 0 < value < 1e6:
        raise InputError(f"{name}: seconds above 0 were expected, not {value:g}")


def split_address(name: str, address: str) -> SplitResult:
    """Return the parts of an address; raise `InputError` for an invalid one, or one with a password."""
    try:
        parts = urlsplit(address)
        _ = parts.port
    except ValueError as error:
        raise InputError(f"{name}: no address: {error}") from error
    if not parts.hostname:
        raise InputError(f"{name} {address!r}: SCHEME://HOST:PORT was expected")
    if parts.password is not None:
        raise InputError(f"{name}: an address holds no password; write it into a file and name that")
    return parts


def check_address(name: str, address: str, safe: tuple[str, ...], plain: tuple[str, ...]) -> None:
    """Raise `InputError` if an address is neither encrypted nor of this machine."""
    parts = split_address(name, address)
    if parts.scheme not in (*safe, *plain):
        raise InputError(f"{name} {address!r} must begin with {' or '.join(f'{scheme}://' for scheme in safe)}")
    if parts.scheme in plain and not is_local(parts.hostname or ""):
        raise InputError(
            f"{name}: {parts.scheme}:// would send everything readable for all; use {safe[0]}://, or an address "
            "of this machine"
        )


def is_local(host: str) -> bool:
    """Whether an address cannot be reached from another machine."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def read_secret(path: Path) -> str:
    """Return the first line of a secret's file; raise `InputError` if it is unreadable or empty."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"secret {path} cannot be read: {error}") from error
    if not lines or not lines[0].strip():
        raise InputError(f"secret {path} is empty; its first line is taken")
    return lines[0].strip()
