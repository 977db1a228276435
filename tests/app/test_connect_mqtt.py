"""MQTT with a real broker: every verdict arrives across restarts of broker and publisher; states stay; TLS."""

import gc
import json
import signal
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import partial
from itertools import count
from pathlib import Path

import paho.mqtt.client as paho
import pytest
from paho.mqtt.enums import CallbackAPIVersion

from softcal.app.connect.alert_monitor import store_alert
from softcal.app.connect.events import events_after
from softcal.app.connect.forwarder import Destination, Forwarder, NotDelivered
from softcal.app.connect.mqtt import estimate_json, list_current_messages, open_mqtt, publish_estimates, state_messages
from softcal.app.connect.settings import MqttSettings
from softcal.core.errors import InputError
from softcal.core.lot import Lot, UnitKey
from softcal.core.messages.reason import plain
from softcal.core.orders import Heartbeat, StationState
from softcal.db.connection import open_registry
from softcal.db.registry import Registry
from tests.wait import wait_until

VERDICTS = 1000
HANDLES = Path("/proc/self/fd")


@dataclass
class Broker:
    """mosquitto as a process of its own, which keeps what it has taken over a restart."""

    program: str
    folder: Path
    port: int
    lines: str = ""
    process: "subprocess.Popen[bytes] | None" = None

    def start(self) -> None:
        listen = f"listener {self.port} 127.0.0.1\n" if "listener" not in self.lines else ""
        persistence = f"persistence true\npersistence_location {self.folder}/\n"
        file = self.folder / "mosquitto.conf"
        file.write_text(f"{listen}allow_anonymous true\n{persistence}max_queued_messages 0\nuser root\n{self.lines}")
        with (self.folder / "log").open("wb") as log:
            self.process = subprocess.Popen([self.program, "-c", file], stdout=log, stderr=log)
        wait_until(self.is_listening, "the broker listens")

    def is_listening(self) -> bool:
        assert self.process is not None and self.process.poll() is None, (self.folder / "log").read_text()
        return "running" in (self.folder / "log").read_text()

    def end(self) -> None:
        """End it in good order: it writes down what it has taken."""
        if self.process is not None:
            self.process.send_signal(signal.SIGTERM)
            self.process.wait(timeout=30)

    def restart(self) -> None:
        self.end()
        self.start()


@pytest.fixture
def broker(tmp_path: Path, require_program, some_port) -> Iterator[Broker]:
    program = require_program("mosquitto")
    (tmp_path / "broker").mkdir()
    mqtt_broker = Broker(program, tmp_path / "broker", some_port())
    mqtt_broker.start()
    yield mqtt_broker
    mqtt_broker.end()


@pytest.fixture
def registry(tmp_path: Path) -> Iterator[Registry]:
    with open_registry(f"sqlite:///{tmp_path / 'registry.db'}") as opened:
        opened.lots.add(Lot("lot 1+", "S0", 50.0))
        yield opened


def settings_of(of: Broker, **more: object) -> MqttSettings:
    values = {"name": "plant", "broker": f"mqtt://127.0.0.1:{of.port}", "begin": "first", "timeout_s": 10.0}
    return MqttSettings(**values | more)


def give_verdicts(registry: Registry, first: int, units: int) -> None:
    with registry.transaction():
        for number in range(first, first + units):
            registry.calibrations.refuse("lot 1+", f"U{number}", "fail", (plain("dead"),))


class Subscriber:
    """A client whose session outlives its connection."""

    def __init__(self, broker: Broker, topic: str = "softcal/#") -> None:
        self.messages: list[tuple[str, str, bool]] = []
        self.client = paho.Client(CallbackAPIVersion.VERSION2, client_id=f"watch-{topic}", clean_session=False)
        self.is_subscribed = False
        self.client.on_message = self._take
        self.client.on_connect = lambda client, *_: client.subscribe(topic, qos=1)
        self.client.on_subscribe = self._subscribed
        self.client.reconnect_delay_set(0.05, 0.2)
        self.client.connect("127.0.0.1", broker.port)
        self.client.loop_start()
        wait_until(lambda: self.is_subscribed, "subscribed")

    def _take(self, client: object, data: object, message: paho.MQTTMessage) -> None:
        self.messages.append((message.topic, message.payload.decode(), message.retain))

    def _subscribed(self, *_: object) -> None:
        self.is_subscribed = True

    def of(self, topic: str) -> list[str]:
        return [payload for name, payload, _ in self.messages if name == topic]

    def end(self) -> None:
        self.client.disconnect()
        self.client.loop_stop()


@pytest.fixture
def subscriber(broker: Broker) -> Iterator[Subscriber]:
    client = Subscriber(broker)
    yield client
    client.end()


def publisher(registry: Registry, settings: MqttSettings) -> Forwarder:
    """A publisher for whose clock every delay is over when it looks again."""
    states, current, hours = (
        partial(state_messages, registry),
        partial(list_current_messages, registry, settings),
        count(),
    )
    destination = Destination(settings, partial(open_mqtt, settings, states, current))
    return Forwarder(registry, destination, lambda: datetime.now(UTC) + timedelta(hours=next(hours)))


@pytest.mark.long
def test_a_client_sees_every_verdict_across_restarts_of_broker_and_publisher(registry, broker, subscriber):
    """1,000 verdicts in ten parts: after each part the broker, the publisher or both begin anew, one in its midst."""
    share, settings = VERDICTS // 10, settings_of(broker)
    forwarder = publisher(registry, settings)
    for part in range(10):
        give_verdicts(registry, share * part, share)
        if part % 3 == 0:
            broker.restart()
        if part % 3 == 1:
            # As a power cut: its connection is cut, nothing is said, and what was under way is forgotten.
            forwarder._sender._client._sock_close() if forwarder._sender else None
            forwarder = publisher(registry, settings)
        if part == 5:
            broker.end()
            forwarder.step()
            broker.start()
        while forwarder.step():
            pass
    wait_until(lambda: not forwarder.step() and has_all(registry), "everything was sent")
    ids = [event.event_id for event in events_after(registry, {}, 2 * VERDICTS, ["verdict"]).events]
    assert len(ids) == VERDICTS
    wait_until(lambda: {json.loads(text)["id"] for text in subscriber.of("softcal/events")} >= set(ids), "all arrived")
    firsts = list(dict.fromkeys(json.loads(text)["id"] for text in subscriber.of("softcal/events")))
    assert firsts == ids
    forwarder.close()


def has_all(registry: Registry) -> bool:
    (state,) = registry.outbox.deliveries()
    return state.cursor == registry.outbox.end() and not state.failures


def test_who_comes_later_finds_the_newest_verdict_of_each_unit(registry, broker):
    give_verdicts(registry, 0, 3)
    registry.calibrations.refuse("lot 1+", "U1", "retest", (plain("press again"),))
    with publisher(registry, settings_of(broker)) as forwarder:
        while forwarder.step():
            pass
    late = Subscriber(broker, "softcal/lots/#")
    wait_until(lambda: len(late.messages) == 3, "three retained verdicts")
    late.end()
    verdicts = {topic: json.loads(text)["data"]["verdict"] for topic, text, is_retained in late.messages if is_retained}
    topic_of_lot = "softcal/lots/lot%201%2B/units"
    assert verdicts == {
        f"{topic_of_lot}/U0/verdict": "fail",
        f"{topic_of_lot}/U1/verdict": "retest",
        f"{topic_of_lot}/U2/verdict": "fail",
    }


def test_a_destination_that_is_new_finds_the_verdicts_and_alerts_from_before_and_no_older_ones(registry, broker):
    golden_alert = {
        "kind": "golden",
        "lot": None,
        "values": {"station": "line-1"},
        "is_urgent": True,
        "text": {"en": "x"},
    }
    give_verdicts(registry, 0, 3)
    registry.calibrations.refuse("lot 1+", "U1", "retest", (plain("press again"),))
    for alert in ("line-1", "line-2"):
        golden_alert["values"] = {"station": alert}
        store_alert(registry, ("golden", "", alert), golden_alert, is_open=True)
    store_alert(registry, ("golden", "", "line-2"), golden_alert, is_open=False)
    early = Subscriber(broker, "softcal/events")
    for number in range(2):  # The second time it is not new, and what happened meanwhile is not overwritten.
        with publisher(registry, settings_of(broker, begin="now")) as forwarder:
            while forwarder.step():
                pass
            registry.calibrations.refuse("lot 1+", "U2", "retest", (plain(f"once more {number}"),))
            while forwarder.step():
                pass
    late = Subscriber(broker, "softcal/#")
    # Of the broker's retained messages the alerts may come last.
    kinds = ("units", "units", "units", "alerts")
    wait_until(
        lambda: all(sum(kind in topic for topic, _, _ in late.messages) >= kinds.count(kind) for kind in kinds), "all"
    )
    late.end()
    payloads = {
        topic: json.loads(text)
        for topic, text, is_retained in late.messages
        if is_retained and text not in ("online", "offline")
    }
    topic_of_lot = "softcal/lots/lot%201%2B/units"
    verdicts = {topic: event["data"]["verdict"] for topic, event in payloads.items() if "units" in topic}
    assert verdicts == {
        f"{topic_of_lot}/U{k}/verdict": verdict for k, verdict in enumerate(("fail", "retest", "retest"))
    }
    assert [topic for topic in payloads if "alerts" in topic] == ["softcal/alerts/golden/-/line-1"]
    # What happened before is no event: those who act on events must not act on it.
    wait_until(lambda: len(early.messages) >= 2, "two events")
    early.end()
    assert len(early.messages) == 2


def test_the_state_of_a_station_is_kept_and_changes_are_published_once(registry, broker, subscriber):
    heartbeat = Heartbeat("line-1", StationState.READY, datetime.now(UTC), process="a:1")
    registry.order_queue.write_heartbeat(heartbeat)
    with publisher(registry, settings_of(broker)) as forwarder:
        forwarder.step()
        registry.order_queue.write_heartbeat(replace(heartbeat, at=datetime.now(UTC)))
        forwarder.step()
        registry.order_queue.write_heartbeat(replace(heartbeat, state=StationState.STOPPED, at=datetime.now(UTC)))
        forwarder.step()
    wait_until(lambda: len(subscriber.of("softcal/stations/line-1/state")) >= 2, "two states")
    states = [json.loads(text)["state"] for text in subscriber.of("softcal/stations/line-1/state")]
    assert states == ["ready", "stopped"]


def test_an_alert_is_kept_until_it_is_over(registry, broker, subscriber):
    golden_alert = {
        "kind": "golden",
        "lot": None,
        "values": {"station": "line-1"},
        "is_urgent": True,
        "text": {"en": "x"},
    }
    with publisher(registry, settings_of(broker)) as forwarder:
        store_alert(registry, ("golden", "", "line-1"), golden_alert, is_open=True)
        forwarder.step()
        store_alert(registry, ("golden", "", "line-1"), golden_alert, is_open=False)
        forwarder.step()
    topic = "softcal/alerts/golden/-/line-1"
    wait_until(lambda: len(subscriber.of(topic)) == 2, "raised and cleared")
    raised, cleared = subscriber.of(topic)
    assert json.loads(raised)["type"] == "softcal.alert.raised" and cleared == ""


def test_a_publisher_that_dies_leaves_its_last_will(registry, broker, subscriber):
    give_verdicts(registry, 0, 1)
    forwarder = publisher(registry, settings_of(broker))
    forwarder.step()
    wait_until(lambda: subscriber.of("softcal/status") == ["online"], "online")
    forwarder._sender._client._sock_close()  # type: ignore[union-attr]
    wait_until(lambda: subscriber.of("softcal/status") == ["online", "offline"], "the last will")
    forwarder.close()


def test_a_broker_that_is_away_is_one_line_and_no_loss(registry, broker, subscriber):
    give_verdicts(registry, 0, 1)
    broker.end()
    forwarder = publisher(registry, settings_of(broker))
    assert forwarder.step() is False
    (state,) = registry.outbox.deliveries()
    assert state.failures == 1 and state.delivered == 0
    broker.start()
    forwarder.step()
    forwarder.close()
    wait_until(lambda: len(subscriber.of("softcal/events")) == 1, "the verdict")


# paho leaves the socket of a handshake that failed to the garbage collector.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_tls_checks_the_broker_and_the_password_stands_in_a_file(broker, tls, tmp_path, some_port):
    port, password = some_port(), tmp_path / "password"
    password.write_text("right\n")
    (tmp_path / "users").write_text("")
    subprocess.run(["mosquitto_passwd", "-b", tmp_path / "users", "line", "right"], check=True, capture_output=True)
    broker.end()
    files = f"cafile {tls.ca}\ncertfile {tls.cert}\nkeyfile {tls.key}\n"
    broker.lines = f"listener {port} 127.0.0.1\n{files}allow_anonymous false\npassword_file {tmp_path / 'users'}\n"
    broker.start()
    safe = settings_of(broker, broker=f"mqtts://line@localhost:{port}", ca_file=tls.ca, password_file=password)
    with open_mqtt(safe) as sender:
        sender.publish([("events", "hello", False)])
    with pytest.raises(NotDelivered), open_mqtt(replace(safe, ca_file=None)):
        pass
    password.write_text("wrong\n")
    with pytest.raises(NotDelivered), open_mqtt(safe):
        pass


@pytest.mark.parametrize("address", ["mqtt://broker.example", "http://127.0.0.1", "mqtts://u:p@b.example", "mqtts://"])
def test_an_address_that_would_tell_everybody_is_refused(address):
    with pytest.raises(InputError):
        MqttSettings(name="plant", broker=address)


ROWS = "t_s,estimate,lower,upper,flag\n0.0,,,,warm-up\n0.02,1.5,1.2,1.8,\n"


def test_live_estimates_are_published_and_the_newest_is_kept(broker):
    rows = ROWS + "0.04,1.6,1.3,1.9,\n"
    assert publish_estimates(rows.splitlines(True), UnitKey("lot 1", "A 1"), settings_of(broker), 1e9) == (3, 0)
    late = Subscriber(broker)
    topic = "softcal/lots/lot%201/units/A%201/estimate"
    wait_until(lambda: late.of(topic), "the newest estimate")
    late.end()
    values = {"t_s": 0.04, "estimate": 1.6, "lower": 1.3, "upper": 1.9, "flag": ""}
    assert [json.loads(text) for text in late.of(topic)] == [{"lot": "lot 1", "serial": "A 1", **values}]


def test_estimates_go_on_when_the_broker_is_away_for_a_while(broker):
    def rows() -> Iterator[str]:
        yield from ROWS.splitlines(True)
        broker.end()
        yield "0.04,1.6,1.3,1.9,\n"
        yield "0.06,1.7,1.4,2.0,\n"

    published, left_out = publish_estimates(rows(), UnitKey("small", "A1"), settings_of(broker), 1e9)
    assert (published, left_out) == (2, 2)
    broker.start()


def test_a_rate_thins_live_estimates(broker):
    assert publish_estimates(
        (ROWS + "0.04,1,1,1,\n" * 50).splitlines(True), UnitKey("small", "A1"), settings_of(broker), 0.01
    ) == (1, 51)


@pytest.mark.parametrize("line", ["1,2,3\n", "a,b,c,d,\n", "\n"])
def test_what_is_no_row_of_estimates_is_refused(line):
    with pytest.raises(InputError):
        estimate_json(line, UnitKey("small", "A1"))


def test_what_is_no_output_of_adapt_is_refused(broker):
    with pytest.raises(InputError):
        publish_estimates(["t_s,output\n"], UnitKey("small", "A1"), settings_of(broker), 10)


def connect_once(broker: Broker, is_cut: bool) -> None:
    with suppress(NotDelivered), open_mqtt(settings_of(broker)) as sender:
        if is_cut:
            broker.restart()
            sender.publish([("topic", "text", False)])


@pytest.mark.skipif(not HANDLES.is_dir(), reason="reads /proc")
@pytest.mark.parametrize("is_cut", [False, True])
def test_a_connection_that_ended_leaves_no_handle_open(broker, is_cut):
    gc.collect()
    gc.disable()
    before = len(list(HANDLES.iterdir()))
    try:
        for _ in range(3):
            connect_once(broker, is_cut)
        assert len(list(HANDLES.iterdir())) == before
    finally:
        gc.enable()
