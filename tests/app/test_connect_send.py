"""Webhooks and mail: every event at least once across failures and restarts, signed, with a growing delay."""

import http.server
import json
import ssl
import threading
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from email import message_from_bytes, policy
from pathlib import Path

import pytest
from aiosmtpd.controller import Controller
from aiosmtpd.smtp import AuthResult, LoginPassword
from standardwebhooks.webhooks import Webhook, WebhookVerificationError

from softcal.app.connect.alert_monitor import store_alert
from softcal.app.connect.events import events_after
from softcal.app.connect.forwarder import LEASE_S, Destination, Forwarder, status_json
from softcal.app.connect.mail import compose_mail, open_mail, render_event
from softcal.app.connect.settings import MailSettings, WebhookSettings
from softcal.app.connect.webhook import new_secret, open_webhook
from softcal.core.errors import InputError
from softcal.core.lot import Lot
from softcal.core.messages.reason import plain
from softcal.db.connection import open_registry
from softcal.db.registry import Registry

DOCS = (Path(__file__).parents[2] / "docs" / "connect.md").read_text(encoding="utf-8")
NOW = datetime(2026, 5, 4, 8, 0, tzinfo=UTC)


@pytest.fixture
def url(tmp_path: Path) -> str:
    return f"sqlite:///{tmp_path / 'registry.db'}"


@pytest.fixture
def registry(url: str) -> Iterator[Registry]:
    with open_registry(url) as opened:
        opened.lots.add(Lot("L1", "S0", 50.0))
        yield opened


def give_verdicts(registry: Registry, first: int, count: int) -> list[str]:
    """Give units a verdict; return their serials."""
    serials = [f"U{number}" for number in range(first, first + count)]
    with registry.transaction():
        for serial in serials:
            registry.calibrations.refuse("L1", serial, "fail", (plain(f"{serial} is dead"),))
    return serials


@dataclass
class Receiver:
    """An HTTP server that notes what it gets and answers as it is told."""

    port: int = 0
    answer: Callable[[int], int] = lambda number: 204
    deliveries: list[tuple[dict[str, str], bytes]] = field(default_factory=list)
    requests: int = 0

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/softcal"


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    http_receiver = Receiver()

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["content-length"]))
            http_receiver.requests += 1
            status = http_receiver.answer(http_receiver.requests)
            if status < 300:
                http_receiver.deliveries.append(({name.lower(): value for name, value in self.headers.items()}, body))
            self.send_response(status)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            return

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    http_receiver.port = server.server_address[1]
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield http_receiver
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.fixture
def webhook(receiver: Receiver, tmp_path: Path) -> Destination:
    (tmp_path / "secret").write_text(new_secret() + "\n")
    settings = WebhookSettings(name="mes", url=receiver.url, secret_file=tmp_path / "secret", begin="first")
    return Destination(settings, lambda: open_webhook(settings))


class Clock:
    """A clock that is set by the test."""

    def __init__(self) -> None:
        self.now = NOW

    def __call__(self) -> datetime:
        return self.now


def deliver(registry: Registry, destination: Destination, clock: Callable[[], datetime] = lambda: NOW) -> None:
    """Bring what waits, in a process that ends after it."""
    with Forwarder(registry, destination, clock) as forwarder:
        while forwarder.step():
            pass


def serials_of(receiver: Receiver) -> list[str]:
    return [json.loads(body)["data"]["serial"] for _, body in receiver.deliveries]


def test_every_verdict_arrives_once_in_order_with_its_id(registry, receiver, webhook):
    serials = give_verdicts(registry, 0, 45)
    deliver(registry, webhook)
    deliver(registry, webhook)
    assert serials_of(receiver) == serials
    expected_events = events_after(registry, {}, 100, ["verdict"]).events
    assert [headers["webhook-id"] for headers, _ in receiver.deliveries] == [
        event.event_id for event in expected_events
    ]
    assert [json.loads(body) for _, body in receiver.deliveries] == [event.to_json() for event in expected_events]


def test_the_library_of_the_standard_verifies_the_signature(registry, receiver, webhook, tmp_path):
    give_verdicts(registry, 0, 1)
    deliver(registry, webhook)
    ((headers, body),) = receiver.deliveries
    secret = (tmp_path / "secret").read_text().strip()
    (block,) = [part.split("```")[0] for part in DOCS.split("```python\n")[1:]]
    signed = {"secret": secret, "body": body, "headers": headers}
    exec(block, signed)
    assert signed["event"] == json.loads(body)
    verifier = Webhook(secret)
    assert verifier.verify(body, headers)["data"]["serial"] == "U0"
    with pytest.raises(WebhookVerificationError):
        verifier.verify(body.replace(b"U0", b"U1"), headers)


def test_nothing_is_lost_and_little_is_doubled_while_the_receiver_fails_and_the_sender_restarts(
    registry, receiver, webhook, url
):
    receiver.answer = lambda number: 503 if number % 3 == 0 else 204
    clock, serials = Clock(), []
    for part in range(6):
        serials += give_verdicts(registry, 10 * part, 10)
        for _ in range(8):
            with open_registry(url) as restarted:
                deliver(restarted, webhook, clock)
            clock.now += timedelta(hours=1)
    # What was confirmed is behind the cursor: one that fails is asked again, those before it are not.
    assert serials_of(receiver) == serials


@dataclass
class Noting:
    """A sender that notes what it brings, and lets something happen while it does."""

    deliveries: list[str]
    meanwhile: Callable[[], object] = lambda: None
    max_events: int = 10

    def send(self, events):
        self.deliveries += [event.data["serial"] for event in events]
        self.meanwhile()


def test_two_processes_on_one_registry_send_everything_once(registry, url, webhook):
    deliveries, clock = [], Clock()
    with open_registry(url) as elsewhere:
        second = Forwarder(elsewhere, Destination(webhook.settings, lambda: nullcontext(Noting(deliveries))), clock)
        busy = Noting(deliveries, meanwhile=second.step)
        first = Forwarder(registry, Destination(webhook.settings, lambda: nullcontext(busy)), clock)
        serials = give_verdicts(registry, 0, 45)
        with first:
            while first.step():
                second.step()
        assert deliveries == serials
        # One that ends gives the destination back: the other goes on at once.
        serials += give_verdicts(registry, 45, 3)
        with second:
            assert not second.step()
        assert deliveries == serials


def test_what_a_process_held_that_was_killed_is_free_after_the_lease(registry, url, webhook):
    deliveries, clock = [], Clock()
    noting = Destination(webhook.settings, lambda: nullcontext(Noting(deliveries)))
    killed = Forwarder(registry, noting, clock)
    serials = give_verdicts(registry, 0, 2)
    killed.step()
    serials += give_verdicts(registry, 2, 2)
    with open_registry(url) as elsewhere, Forwarder(elsewhere, noting, clock) as second:
        clock.now += timedelta(seconds=LEASE_S - 1)
        second.step()
        assert deliveries == serials[:2]
        clock.now += timedelta(seconds=2)
        second.step()
        assert deliveries == serials
        # Back from a long sleep, the first one finds it taken.
        serials += give_verdicts(registry, 4, 1)
        killed.step()
        assert deliveries == serials[:4]
        second.step()
    assert deliveries == serials


@pytest.mark.parametrize("jump", [-timedelta(days=1), timedelta(days=1)])
def test_a_clock_that_is_set_stops_no_destination_and_status_says_so(registry, receiver, webhook, jump):
    clock = Clock()
    give_verdicts(registry, 1, 3)
    receiver.answer = lambda number: 503
    # It failed, is served by a process that is killed, and then the clock is set.
    dead = Forwarder(registry, webhook, clock)
    assert not dead.step()
    assert status_json(registry, clock.now)[0]["served_by"] == dead.holder
    clock.now += jump
    (status,) = status_json(registry, clock.now)
    assert status["served_by"] is None and status["next_try"] is None
    assert ("clock" in status["error"]) == (jump < timedelta(0))
    receiver.answer = lambda number: 204
    with Forwarder(registry, webhook, clock) as forwarder:
        while forwarder.step():
            pass
        # Nor does one that goes on living lose its hold for a day.
        clock.now += jump
        give_verdicts(registry, 4, 1)
        while forwarder.step():
            pass
        assert status_json(registry, clock.now)[0]["served_by"] == forwarder.holder
    assert status_json(registry, clock.now)[0]["sent"] == 4


def test_a_process_that_lost_its_lease_while_it_sent_moves_nothing_back(registry, url, webhook):
    deliveries, clock = [], Clock()
    serials = give_verdicts(registry, 0, 20)
    with open_registry(url) as elsewhere:
        noting = Destination(webhook.settings, lambda: nullcontext(Noting(deliveries)))
        second = Forwarder(elsewhere, noting, clock)

        def meanwhile():
            clock.now += timedelta(seconds=2 * LEASE_S)
            while second.step():
                pass

        slow = Noting([], meanwhile=meanwhile)
        Forwarder(registry, Destination(webhook.settings, lambda: nullcontext(slow)), clock).step()
        assert deliveries == serials
        (state,) = registry.outbox.deliveries()
        assert state.cursor == registry.outbox.end() and state.delivered == 20


def test_the_delay_grows_until_it_is_a_quarter_of_an_hour(registry, receiver, webhook):
    give_verdicts(registry, 0, 1)
    receiver.answer = lambda number: 500
    clock, waits = Clock(), []
    for failures in range(1, 14):
        deliver(registry, webhook, clock)
        (state,) = registry.outbox.deliveries()
        assert state.failures == failures and "500" in state.error
        waits.append((state.not_before - clock.now).total_seconds())
        requests_before, clock.now = receiver.requests, state.not_before - timedelta(seconds=0.1)
        deliver(registry, webhook, clock)
        assert receiver.requests == requests_before, "asked before the delay was over"
        clock.now = state.not_before
    assert waits == [1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 900, 900, 900]


def test_a_destination_that_is_new_begins_with_what_happens_from_now_on(registry, receiver, webhook):
    give_verdicts(registry, 0, 3)
    settings = replace(webhook.settings, begin="now")
    now = Destination(settings, webhook.open_sender)
    deliver(registry, now)
    serials = give_verdicts(registry, 3, 2)
    deliver(registry, now)
    assert serials_of(receiver) == serials


def test_a_destination_gets_the_kinds_it_asked_for(registry, receiver, webhook):
    give_verdicts(registry, 0, 2)
    store_alert(registry, ("yield", "L1", ""), {"kind": "yield", "lot": "L1", "text": {"en": "x"}}, is_open=True)
    deliver(registry, Destination(replace(webhook.settings, events=("alert",)), webhook.open_sender))
    assert [json.loads(body)["type"] for _, body in receiver.deliveries] == ["softcal.alert.raised"]


def test_a_receiver_that_is_not_there_is_one_line_and_no_loss(registry, webhook, receiver):
    give_verdicts(registry, 0, 1)
    away = replace(webhook.settings, url="http://127.0.0.1:9/none")
    deliver(registry, Destination(away, lambda: open_webhook(away)))
    (state,) = registry.outbox.deliveries()
    assert state.failures == 1 and state.delivered == 0 and state.error and "\n" not in state.error
    deliver(registry, webhook, lambda: NOW + timedelta(minutes=1))
    assert serials_of(receiver) == ["U0"]


@pytest.mark.parametrize(
    "address",
    ["http://example.com/x", "ftp://127.0.0.1/x", "https://user:password@example.com/x", "127.0.0.1", "https://"],
)
def test_an_address_that_would_tell_everybody_is_refused(address, tmp_path):
    with pytest.raises(InputError):
        WebhookSettings(name="mes", url=address, secret_file=tmp_path / "secret")


@pytest.mark.parametrize("secret", ["", "hunter2", "whsec_", "whsec_c2hvcnQ=", "whsec_!!!"])
def test_a_secret_that_is_none_is_refused(secret, tmp_path, receiver):
    (tmp_path / "secret").write_text(secret)
    settings = WebhookSettings(name="mes", url=receiver.url, secret_file=tmp_path / "secret")
    with pytest.raises(InputError), open_webhook(settings):
        pass


class Mailbox:
    """Keeps mails; refuses the first `refused` of them."""

    def __init__(self) -> None:
        self.mails: list[bytes] = []
        self.refused = 0

    async def handle_DATA(self, server, session, envelope):  # noqa: N802 - aiosmtpd's name
        if self.refused:
            self.refused -= 1
            return "451 try again later"
        self.mails.append(envelope.content)
        return "250 taken"


@pytest.fixture
def mailbox(some_port) -> Iterator[tuple[Mailbox, int]]:
    box, port = Mailbox(), some_port()
    controller = Controller(box, hostname="127.0.0.1", port=port)
    controller.start()
    yield box, port
    controller.stop()


ALERT = {
    "kind": "golden", "lot": None, "is_urgent": True, "values": {"station": "line-1"},
    "text": {"en": "Station line-1 failed.", "ko": "스테이션 line-1 불합격."},
}  # fmt: skip


def mail_settings(port: int, **more) -> MailSettings:
    values = {"name": "people", "server": f"smtp://127.0.0.1:{port}", "sender": "line@plant.example"}
    return MailSettings(**values | {"to": ("q@plant.example",), "begin": "first"} | more)


def test_alerts_arrive_by_mail_in_the_language_of_the_reader_and_none_is_lost(registry, mailbox):
    box, port = mailbox
    settings = mail_settings(port, language="ko")
    people, clock = Destination(settings, lambda: open_mail(settings)), Clock()
    store_alert(registry, ("golden", "", "line-1"), ALERT, is_open=True)
    give_verdicts(registry, 0, 5)
    box.refused = 2
    for _ in range(4):
        deliver(registry, people, clock)
        clock.now += timedelta(minutes=10)
    (mail,) = [message_from_bytes(content, policy=policy.default) for content in box.mails]
    assert "스테이션 line-1 불합격." in mail.get_content() and mail["To"] == "q@plant.example"
    assert "U0" not in mail.get_content()
    assert mail["X-Softcal-Events"].split() == [events_after(registry, {}, 9, ["alert"]).events[0].event_id]


def test_what_waits_goes_out_as_one_mail(registry, mailbox):
    box, port = mailbox
    settings = mail_settings(port, events=("verdict",))
    give_verdicts(registry, 0, 7)
    deliver(registry, Destination(settings, lambda: open_mail(settings)))
    (mail,) = [message_from_bytes(content, policy=policy.default) for content in box.mails]
    lines = mail.get_content().splitlines()
    for number in range(7):
        assert len([line for line in lines if f"U{number}" in line and "L1" in line and "Fail" in line]) == 1
    assert "7" in mail["Subject"]


def test_the_same_events_make_the_same_mail(registry):
    give_verdicts(registry, 0, 2)
    events = events_after(registry, {}, 9, ["verdict"]).events
    first, second = (compose_mail(events, mail_settings(25)).as_bytes() for _ in range(2))
    assert first == second


def test_a_line_break_in_an_event_makes_no_header_of_a_mail(registry):
    registry.calibrations.refuse("L1", "U1", "fail", (plain("x\r\nBcc: all@plant.example"),))
    (event,) = events_after(registry, {}, 9, ["verdict"]).events
    mail = message_from_bytes(compose_mail([event], mail_settings(25)).as_bytes(), policy=policy.default)
    assert mail["Bcc"] is None and "\n" not in render_event(event, "en")


def test_mail_goes_over_tls_with_a_password_from_a_file(registry, tmp_path, tls, some_port):
    mails, port = [], some_port()

    def check_login(server, session, envelope, mechanism, data):
        mails.append((isinstance(data, LoginPassword), data.login, data.password, session.ssl is not None))
        return AuthResult(success=data.password == b"right")

    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(tls.cert, tls.key)
    box = Mailbox()
    options = {"tls_context": context, "require_starttls": True, "authenticator": check_login, "auth_required": True}
    controller = Controller(box, hostname="127.0.0.1", port=port, **options)
    controller.start()
    try:
        address = {"server": f"smtp+starttls://line@localhost:{port}", "ca_file": tls.ca, "events": ("verdict",)}
        (tmp_path / "password").write_text("right\n")
        settings = mail_settings(port, **address, password_file=tmp_path / "password")
        give_verdicts(registry, 0, 1)
        deliver(registry, Destination(settings, lambda: open_mail(settings)))
        assert len(box.mails) == 1 and mails == [(True, b"line", b"right", True)]
        other_settings = replace(settings, name="other", ca_file=None)
        deliver(registry, Destination(other_settings, lambda: open_mail(other_settings)))
        state = {d.destination: d for d in registry.outbox.deliveries()}["other"]
        assert state.failures == 1 and state.delivered == 0 and len(box.mails) == 1
    finally:
        controller.stop()
