"""The paper's online method: queues mapped by exact transport, the rule of the swap, and the source that moves."""

import json
import threading
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import ot
import pytest

from softcal.app.registry.unit import source_state
from softcal.core.errors import InputError
from softcal.core.maps.affine_map import AffineMap
from softcal.core.maps.anchors import AnchoredMap
from softcal.core.network.network import Network
from softcal.core.operation.adapter import AdaptConfig, Adapter
from softcal.core.operation.method import DriftTracking, OnlineConfig
from softcal.core.operation.queued_transport import QueuedTransport
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.unit.estimate import STUCK
from softcal.core.unit.state import UnitState
from softcal.core.windows import TAPS, windows
from tests.layers import layered
from tests.unit_states import with_fitted

RATE_HZ, QUEUE, BATCH = 50.0, 320, 32
REST_V, GAIN_V_N = 0.8, 0.25
MODES = ("ot", "ot-improved")
Bench = tuple[Network, UnitState, LabelledRecording]


def load_N(seconds: float, seed: int) -> Array:
    """Presses of about 2 N, one every 1.5 s."""
    t_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    heights = 2 * (1 + 0.03 * np.random.default_rng(seed).normal(size=int(seconds / 1.5) + 1))
    return np.asarray(heights[(t_s / 1.5).astype(int)] * np.sin(np.pi * t_s / 1.5) ** 2)


def read_V(force_N: Array, seed: int) -> Array:
    return REST_V + GAIN_V_N * force_N + 0.002 * np.random.default_rng(seed).normal(size=len(force_N))


@pytest.fixture(scope="module")
def bench() -> Bench:
    """f(window) = (newest sample - 0.8 V) / 0.25 V/N, as relu(x) - relu(-x), and the source itself as the unit."""
    first, second = np.zeros((TAPS, 2)), np.array([[1.0], [-1.0]])
    first[-1] = [1.0, -1.0]
    network = Network((first, second), (np.zeros(2), np.zeros(1)), REST_V, GAIN_V_N, 0.0, 1.0)
    force_N = load_N(30.0, 0)
    output = OutputRecording("A0", np.arange(len(force_N)) / RATE_HZ, read_V(force_N, 1), RATE_HZ)
    source = LabelledRecording(output, force_N)
    return network, source_state(source, network), source


def make(bench: Bench, mode: str, queue: int = QUEUE, pool: Executor | None = None) -> QueuedTransport:
    network, calibration, source = bench
    config = AdaptConfig(mode, DriftTracking(online=OnlineConfig(queue)))
    return QueuedTransport(network, calibration, source.unlabelled, source, config, pool)


def stream(seconds: float = 60.0, last_gain: float = 0.7) -> tuple[Array, Array, Array]:
    """Times, an output whose gain drifts, and the load."""
    force_N = load_N(seconds, 3)
    output_V = REST_V + (read_V(force_N, 5) - REST_V) * np.linspace(1, last_gain, len(force_N))
    return np.arange(len(force_N)) / RATE_HZ, output_V, force_N


def full_at(queues: int) -> int:
    """Return the row from which on so many queues are full: batches end at multiples of 32."""
    return -(-(queues * QUEUE + TAPS - 1) // BATCH) * BATCH


def rmse(estimate: Array, reference: Array) -> float:
    return float(np.sqrt(np.nanmean((estimate - reference) ** 2)))


def test_the_map_of_a_queue_is_the_barycentric_projection_of_pots_plan(bench: Bench) -> None:
    _, _, source = bench
    t_s, output_V, _ = stream()
    follower = make(bench, "ot")
    follower.advance(t_s[: full_at(2)], output_V[: full_at(2)])

    queue = windows(output_V)[:QUEUE]
    plan = ot.emd(ot.unif(QUEUE), ot.unif(len(source.windows)), ot.dist(queue, source.windows))
    np.testing.assert_allclose(follower.unit_map.apply(queue), QUEUE * plan @ source.windows, atol=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("mode", MODES)
def test_the_map_of_a_queue_holds_once_the_next_is_full(bench: Bench, mode: str) -> None:
    t_s, output_V, _ = stream()
    network, calibration, source = bench
    follower = make(bench, mode)
    rows = follower.advance(t_s, output_V)
    none = Adapter(network, calibration, source.unlabelled, AdaptConfig("none")).advance(t_s, output_V)

    before = slice(0, full_at(2))
    np.testing.assert_array_equal(rows.estimate[before], none.estimate[before])
    swaps = [update.row for update in follower.take_updates() if update.verdict == "followed"]
    assert swaps == [full_at(k) for k in range(2, (len(t_s) - TAPS + 1) // QUEUE + 1)]


@pytest.mark.parametrize("mode", layered(MODES, ("ot-improved",)))
def test_a_gain_that_drifts_over_queues_is_followed(bench: Bench, mode: str) -> None:
    t_s, output_V, force_N = stream(120.0)
    network, calibration, source = bench
    late = slice(len(t_s) // 2, None)

    followed = make(bench, mode).advance(t_s, output_V).estimate
    none = Adapter(network, calibration, source.unlabelled, AdaptConfig("none")).advance(t_s, output_V).estimate

    assert rmse(followed[late], force_N[late]) < 0.6 * rmse(none[late], force_N[late])


def test_improved_the_source_is_the_last_queue_with_its_best_estimates(bench: Bench) -> None:
    network, _, source = bench
    t_s, output_V, _ = stream()
    improved, plain = make(bench, "ot-improved"), make(bench, "ot")
    for follower in (improved, plain):
        follower.advance(t_s[: full_at(3)], output_V[: full_at(3)])

    second = windows(output_V)[QUEUE : 2 * QUEUE]
    assert improved.source is not None and plain.source is not None
    np.testing.assert_array_equal(improved.source.windows, second)
    best = network.evaluate(improved.unit_map.apply(second))
    np.testing.assert_allclose(network.evaluate(improved.source.mapped), best, atol=1e-6)
    np.testing.assert_array_equal(plain.source.windows, source.windows)


class Prompt(Executor):
    """A pool whose plans are ready in time, on any machine."""

    def submit(self, fn, /, *args, **kwargs):
        solved: Future = Future()
        solved.set_result(fn(*args, **kwargs))
        return solved


@pytest.mark.parametrize("mode", layered(MODES, ("ot-improved",)))
def test_pieces_a_pool_and_a_restart_give_the_same_rows(bench: Bench, mode: str) -> None:
    t_s, output_V, _ = stream()
    whole = make(bench, mode).advance(t_s, output_V).estimate
    pool = Prompt()
    follower, nested_list = make(bench, mode, pool=pool), []
    for k in range(0, len(t_s), 777):
        nested_list.append(follower.advance(t_s[k : k + 777], output_V[k : k + 777]).estimate)
        state = json.loads(json.dumps(follower.state()))
        follower = make(bench, mode, pool=pool)
        assert follower.restore(state) == []

    np.testing.assert_array_equal(np.concatenate(nested_list), whole)


def test_rows_that_are_no_evidence_enter_no_queue(bench: Bench) -> None:
    t_s, output_V, _ = stream()
    output_V = output_V.copy()
    output_V[200:1200] = output_V[200]
    follower = make(bench, "ot")

    rows = follower.advance(t_s[:1200], output_V[:1200])

    assert sum(flag.startswith(STUCK) for flag in rows.flag) > 900
    assert follower.current.verdict == "start" and "cable" in follower.current.alarm


def test_an_interruption_breaks_the_window_and_keeps_the_map(bench: Bench) -> None:
    t_s, output_V, _ = stream()
    follower = make(bench, "ot")
    follower.advance(t_s[:900], output_V[:900])
    map_before = follower.unit_map

    follower.reconnect()

    rows = follower.advance(t_s[:40] + 500, output_V[900:940])
    assert np.isnan(rows.estimate[: TAPS - 1]).all() and np.isfinite(rows.estimate[TAPS - 1 :]).all()
    assert follower.unit_map is map_before


def test_what_cannot_be_is_refused(bench: Bench) -> None:
    network, calibration, source = bench
    with pytest.raises(InputError, match="smaller than a window"):
        make(bench, "ot", queue=TAPS - 1)
    with pytest.raises(ValueError, match="improved"):
        make(bench, "improved")
    with pytest.raises(ValueError, match="ot"):
        Adapter(network, calibration, source.unlabelled, AdaptConfig("ot"))
    state = make(bench, "ot").state()
    broken = {**state, "arrays": {"filling": [[0.0]], "waiting": []}}
    for wrong in (broken, {**state, "format": "queues 0 ot"}, {**state, "more": 1}):
        with pytest.raises(InputError):
            make(bench, "ot").restore(wrong)
    other = replace(source.unlabelled, output_unit="mV")
    with pytest.raises(InputError):
        QueuedTransport(network, calibration, other, source, AdaptConfig("ot"))


def mixed(n: int, seed: int) -> Array:
    """A programme whose loads change from minute to minute: no single queue holds it."""
    force_N = load_N(n / RATE_HZ + 2, seed)[:n]
    return force_N * np.repeat(np.random.default_rng(seed).uniform(0.4, 1.3, n // 400 + 1), 400)[:n]


@pytest.mark.long
def test_queues_that_differ_by_chance_are_said_to_be_unwatched_and_their_error_is_in_the_interval(bench: Bench) -> None:
    network, calibration, source = bench
    recording = replace(source.unlabelled, output=read_V(mixed(len(source.reference), 7), 8))
    labelled = LabelledRecording(recording, mixed(len(source.reference), 7))
    follower = QueuedTransport(
        network, calibration, recording, labelled, AdaptConfig("ot", DriftTracking(online=OnlineConfig(QUEUE)))
    )
    force_N = mixed(6000, 9)

    rows = follower.advance(np.arange(6000) / RATE_HZ, read_V(force_N, 10))

    late = slice(1000, None)
    assert rmse(rows.estimate[late], force_N[late]) > 0.1
    assert all("unwatched" in flag for flag in rows.flag)
    assert np.mean((rows.lower <= force_N) & (force_N <= rows.upper)) > 0.85


@pytest.mark.parametrize("mode", MODES)
def test_a_change_of_use_is_in_the_interval_and_alarmed(bench: Bench, mode: str) -> None:
    t_s, _, _ = stream()
    force_N = load_N(60.0, 3) * np.where(t_s > 20, 1.5, 1.0)
    follower = make(bench, mode)

    rows = follower.advance(t_s, read_V(force_N, 5))

    late = slice(len(t_s) // 2 + 640, None)
    assert np.mean((rows.lower <= force_N) & (force_N <= rows.upper)) > 0.85
    assert all("recalibrate" in flag or "range" in flag or "familiar" in flag for flag in rows.flag[late])


@pytest.mark.parametrize("mode", MODES)
def test_known_loads_outlast_every_swap(bench: Bench, mode: str) -> None:
    """The calibration reads a tenth too low, and known loads have mended that."""
    network, calibration, source = bench
    wrong = AffineMap(0.9, 0.1 * REST_V, "affine")
    anchored = with_fitted(calibration, unit_map=AnchoredMap(wrong, 1 / 0.9, REST_V - REST_V / 0.9))
    t_s, _, force_N = stream()
    later_N = 0.6 * force_N
    config = AdaptConfig(mode, DriftTracking(online=OnlineConfig(QUEUE)))

    rows = QueuedTransport(network, anchored, source.unlabelled, source, config).advance(t_s, read_V(later_N, 5))

    # Mapped onto the source, whose loads are 1 / 0.6 as large, every estimate would be so too.
    assert rmse(rows.estimate, later_N) < 0.1


def test_estimates_never_wait_for_a_plan(bench: Bench) -> None:
    t_s, output_V, _ = stream()
    network, calibration, source = bench
    none = Adapter(network, calibration, source.unlabelled, AdaptConfig("none")).advance(t_s, output_V)
    with ThreadPoolExecutor(1) as pool:
        is_free = threading.Event()
        pool.submit(is_free.wait, 60.0)
        follower = make(bench, "ot", pool=pool)
        rows = follower.advance(t_s[:2000], output_V[:2000])
        is_free.set()
        pool.submit(lambda: None).result()
        later = follower.advance(t_s[2000:], output_V[2000:])

    np.testing.assert_array_equal(rows.estimate, none.estimate[:2000])
    assert "followed" in later.flag[-1]
    assert len(json.dumps(follower.state())) < 3e6


def test_a_queue_of_another_length_is_refused(bench: Bench) -> None:
    state = make(bench, "ot").state()

    with pytest.raises(InputError, match=rf"{QUEUE} windows.*{QUEUE} was expected"):
        make(bench, "ot", queue=2 * QUEUE).restore(state)
