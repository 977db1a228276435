"""Events as mail: all waiting events in one mail, so that many events do not fill a mailbox."""

import smtplib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from email.message import EmailMessage
from email.utils import format_datetime

from softcal.app.connect.events import CLEARED, RAISED, VERDICT, RegistryEvent
from softcal.app.connect.forwarder import NotDelivered
from softcal.app.connect.settings import MailSettings, read_secret, split_address
from softcal.app.connect.webhook import tls_context
from softcal.app.texts.catalogue import format_local_instant, text
from softcal.core.errors import printable

PORTS = {"smtps": 465, "smtp+starttls": 587, "smtp": 25}


@contextmanager
def open_mail(settings: MailSettings) -> Iterator["MailSender"]:
    """Return a sender of mails; it signs in for each mail, as servers close idle connections."""
    yield MailSender(settings)


class MailSender:
    """Sends what waits as one mail."""

    max_events = 50

    def __init__(self, settings: MailSettings) -> None:
        self._settings = settings

    def send(self, events: Sequence[RegistryEvent]) -> None:
        """Send events as one mail; raise `NotDelivered` if the server does not confirm."""
        if not events:
            return
        try:
            with self._server() as server:
                server.send_message(compose_mail(events, self._settings))
        except (smtplib.SMTPException, OSError) as error:
            raise NotDelivered(f"{self._settings.server} did not take the mail: {error}") from error

    def check(self) -> None:
        """Sign in and close the connection; raise `NotDelivered` if the server is not reachable or refuses."""
        try:
            with self._server() as server:
                server.noop()
        except (smtplib.SMTPException, OSError) as error:
            raise NotDelivered(f"{self._settings.server} cannot be reached: {error}") from error

    def _server(self) -> smtplib.SMTP:
        settings, parts = self._settings, split_address("server", self._settings.server)
        address = (parts.hostname or "", parts.port or PORTS[parts.scheme])
        tls = tls_context(settings.ca_file) if parts.scheme != "smtp" else None
        if parts.scheme == "smtps":
            server: smtplib.SMTP = smtplib.SMTP_SSL(*address, timeout=settings.timeout_s, context=tls)
        else:
            server = smtplib.SMTP(*address, timeout=settings.timeout_s)
        try:
            if parts.scheme == "smtp+starttls":
                server.starttls(context=tls)
            if parts.username and settings.password_file is not None:
                server.login(parts.username, read_secret(settings.password_file))
        except BaseException:
            server.close()
            raise
        return server


def compose_mail(events: Sequence[RegistryEvent], settings: MailSettings) -> EmailMessage:
    """Return the mail of events, in the language of the settings."""
    lines = [render_event(event, settings.language) for event in events]
    raised = sum(event.kind == RAISED for event in events)
    mail = EmailMessage()
    first = lines[0] if len(lines) == 1 else text(settings.language, "mail.subject", count=len(lines), raised=raised)
    mail["Subject"] = f"softcal: {first[:120]}"
    mail["From"], mail["To"] = settings.sender, ", ".join(settings.to)
    mail["Date"] = format_datetime(events[-1].at)
    # The same events give the same id, so that a mail sent twice is known as one.
    ids = ".".join(events[k].event_id.replace(":", "-") for k in (0, -1))
    mail["Message-ID"] = f"<{ids}@{settings.sender.partition('@')[2]}>"
    mail["X-Softcal-Events"] = " ".join(event.event_id for event in events)
    mail.set_content("\n\n".join(lines) + "\n\n" + text(settings.language, "mail.foot") + "\n")
    return mail


def render_event(event: RegistryEvent, language: str) -> str:
    """Return one event as one line, whatever text it quotes."""
    data = event.data
    if event.kind in (RAISED, CLEARED):
        sentence = data["text"].get(language, data["text"]["en"])
        sentence = sentence if data["lot"] is None else text(language, "mail.of_lot", lot=data["lot"], said=sentence)
        key, values = "mail.raised" if event.kind == RAISED else "mail.cleared", {"said": sentence}
    elif event.kind == VERDICT:
        values = {"verdict": text(language, f"verdict.{data['verdict']}"), "why": "; ".join(data["reasons"])}
        key, values = "mail.verdict", values | {"serial": data["serial"], "lot": data["lot"]}
    else:
        key, values = "mail.change", {"what": event.subject, "actor": data["actor"]}
    # What it quotes may come from a file and may not end the line.
    return printable(text(language, key, at=format_local_instant(event.at), **values))
