"""Following one unit in use: causality, faults in the stream, resuming, alarms. f is exact and known in closed form."""

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from softcal.core.errors import InputError
from softcal.core.maps.affine_map import AffineMap
from softcal.core.network.network import Network
from softcal.core.operation.adapter import STATE_FORMAT, AdaptConfig, Adapter, learn_sensitivity
from softcal.core.operation.method import DriftTracking
from softcal.core.operation.stream_estimator import FLAG_SEPARATOR, RECALIBRATE, STATES, UNSETTLED
from softcal.core.operation.stream_windows import WRONG_RATE
from softcal.core.operation.uncertainty import MOVED_WHILE_LEARNT
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.unit.estimate import GAP, INVALID, STUCK, WARM_UP, estimate
from softcal.core.unit.fit import FittedMap
from softcal.core.unit.health import output_limits
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import make_source_model
from softcal.core.unit.state import UnitState
from softcal.core.unit.uncertainty import ErrorForecast
from softcal.core.unit.verdict import Limit
from softcal.core.windows import TAPS
from tests.unit_states import fit_of

RATE_HZ = 50.0
REST_V, GAIN_V_N = 0.8, 0.25
MEMORY_V_N = 0.05
"""What a few seconds of a mean load leave in the output."""


def exact_network() -> Network:
    """f(window) = (newest sample - 0.8 V) / 0.25 V/N, as relu(x) - relu(-x)."""
    first, second = np.zeros((TAPS, 2)), np.array([[1.0], [-1.0]])
    first[-1] = [1.0, -1.0]
    return Network((first, second), (np.zeros(2), np.zeros(1)), REST_V, GAIN_V_N, 0.0, 1.0)


def walk_N(seconds: float, seed: int) -> Array:
    """Presses of 0 to about 2 N, one every 1.5 s, never twice the same."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    heights = 2 * (1 + 0.03 * rng.normal(size=int(seconds / 1.5) + 1))
    return np.asarray(heights[(t_s / 1.5).astype(int)] * np.sin(np.pi * t_s / 1.5) ** 2)


def read_V(force_N: Array, seed: int) -> Array:
    return REST_V + GAIN_V_N * force_N + 0.002 * np.random.default_rng(seed).normal(size=len(force_N))


def maker(
    force_N: Array,
    output_V: Array | None = None,
    network: Network = exact_network(),  # noqa: B008 - frozen
) -> Callable[..., Adapter]:
    """Return a function that makes adapters of a unit calibrated under a load."""
    output_V = read_V(force_N, 1) if output_V is None else output_V
    recording = OutputRecording("A1", np.arange(len(force_N)) / RATE_HZ, output_V, RATE_HZ)
    interval = make_source_model(
        LabelledRecording(recording, force_N), network, np.arange(0, 4000, 7), method=Method()
    ).interval
    identity, limits = AffineMap(1.0, 0.0, "identity"), output_limits(recording, recording, True, Method())
    fitted, forecast = FittedMap(identity, interval, limits), ErrorForecast(0.01, 0.01, 0.01)
    fit = fit_of("A1", network.id, recording.sha256, fitted=fitted, forecast=forecast)
    calibration = UnitState(fit=fit, limit=Limit("N", 1.0))

    def make(mode: str = "improved", method: DriftTracking = DriftTracking()) -> Adapter:  # noqa: B008 - frozen
        return Adapter(network, calibration, recording, AdaptConfig(mode, method))

    make.calibration, make.network = calibration, network  # type: ignore[attr-defined]
    return make


@pytest.fixture(scope="module")
def make_adapter() -> Callable[..., Adapter]:
    return maker(walk_N(90.0, 0))


@pytest.fixture(scope="module")
def make_irregular() -> Callable[..., Adapter]:
    return maker(irregular_N(90.0, 4))


def stream(seconds: float = 120.0, seed: int = 3) -> tuple[Array, Array, Array]:
    force_N = walk_N(seconds, seed)
    return np.arange(len(force_N)) / RATE_HZ, read_V(force_N, seed + 100), force_N


def drifted(output_V: Array, gain: float = 0.85, offset_V: float = 0.0) -> Array:
    share = np.linspace(0, 1, len(output_V))
    return np.asarray(output_V * (1 + share * (gain - 1)) + share * offset_V)


def rmse(values: Array, reference: Array) -> float:
    return float(np.sqrt(np.nanmean((values - reference) ** 2)))


def why(flags: Array) -> list[str]:
    """Why each row is not to be trusted; empty where it is. The last word of a flag is the state of its map."""
    assert {flag.rpartition(FLAG_SEPARATOR)[2] for flag in flags} <= set(STATES)
    return [flag.rpartition(FLAG_SEPARATOR)[0] for flag in flags]


def state(flags: Array) -> list[str]:
    return [flag.rpartition(FLAG_SEPARATOR)[2] for flag in flags]


def test_one_by_one_and_in_pieces_give_the_same_rows(make_adapter: Callable[..., Adapter]) -> None:
    t_s, output_V, _ = stream(30.0)
    output_V = drifted(output_V)
    whole = make_adapter().advance(t_s, output_V)
    single, pieces = make_adapter(), make_adapter()

    rows = [single.step(t, v) for t, v in zip(t_s, output_V, strict=True)]
    nested_list = [pieces.advance(t_s[k : k + 77], output_V[k : k + 77]) for k in range(0, len(t_s), 77)]

    for name in ("estimate", "lower", "upper"):
        column = getattr(whole, name)
        np.testing.assert_array_equal([getattr(row, name) for row in rows], column)
        np.testing.assert_array_equal(np.concatenate([getattr(nested, name) for nested in nested_list]), column)
    assert [row.flag for row in rows] == whole.flag.tolist()


def test_a_row_does_not_depend_on_later_rows(make_adapter: Callable[..., Adapter]) -> None:
    t_s, output_V, _ = stream()
    changed = drifted(output_V).copy()
    cut = 3333
    changed[cut:] = np.random.default_rng(0).normal(1, 0.3, len(changed) - cut)

    before = make_adapter().advance(t_s, drifted(output_V))
    after = make_adapter().advance(t_s, changed)
    short = make_adapter().advance(t_s[:cut], changed[:cut])

    for other in (after, short):
        np.testing.assert_array_equal(other.estimate[:cut], before.estimate[:cut])
        np.testing.assert_array_equal(other.upper[:cut], before.upper[:cut])
        assert other.flag[:cut].tolist() == before.flag[:cut].tolist()


def test_without_drift_it_is_the_plain_estimate(make_adapter: Callable[..., Adapter]) -> None:
    t_s, output_V, force_N = stream(300.0)
    recording = OutputRecording("A1", t_s, output_V, RATE_HZ)
    plain = estimate(make_adapter.network, make_adapter.calibration, recording)  # type: ignore[attr-defined]

    adapted = make_adapter().advance(t_s, output_V)
    unmoved = make_adapter("none").advance(t_s, output_V)

    np.testing.assert_allclose(unmoved.estimate, plain.estimate, atol=1e-6)
    assert rmse(adapted.estimate, force_N) <= 1.02 * rmse(plain.estimate, force_N)


def test_drift_is_followed(make_adapter: Callable[..., Adapter]) -> None:
    t_s, output_V, force_N = stream(600.0)
    last = slice(len(t_s) // 2, None)

    raw = make_adapter("none").advance(t_s, drifted(output_V)).estimate
    followed = make_adapter().advance(t_s, drifted(output_V)).estimate

    assert rmse(raw[last], force_N[last]) > 0.1
    assert rmse(followed[last], force_N[last]) < 0.025


def test_a_use_that_turns_without_a_rest_has_its_zero_load_where_f_sees_it_in_motion() -> None:
    # f takes off the curvature over 0.1 s, as of a sensor that relaxes: it sees 0.1 V cos as 0.1328 V cos, 9.7 degrees
    # later. So zero load lies 0.0342 V above the constant output that f takes for zero.
    first, second = np.zeros((TAPS, 2)), np.array([[1.0], [-1.0]])
    first[[-6, -11], 0] = 2.0, -1.0
    first[:, 1] = -first[:, 0]
    network = Network((first, second), (np.zeros(2), np.zeros(1)), REST_V, GAIN_V_N, 0.0, 1.0)
    phase = 2 * np.pi * np.arange(6000) / RATE_HZ
    noise_V = 0.0005 * np.random.default_rng(8).normal(size=6000)
    output_V = REST_V + 0.0328 + 0.1 * (1 - np.cos(phase)) + noise_V
    load_N = 0.1328 / GAIN_V_N * (1 - np.cos(phase - np.deg2rad(9.73)))

    adapter = maker(load_N, output_V, network)
    recording = OutputRecording("A1", np.arange(len(output_V)) / RATE_HZ, output_V, RATE_HZ)

    operation, _ = learn_sensitivity(adapter.network, adapter.calibration, recording, DriftTracking())  # type: ignore[attr-defined]

    assert operation.zero is not None and operation.curve is not None
    assert operation.mean + operation.scale * operation.zero == pytest.approx(REST_V + 0.0342, abs=0.004)
    assert np.interp(operation.zero, operation.curve.output, operation.curve.load) == pytest.approx(0, abs=0.01)


def test_drift_that_is_followed_raises_no_alarm(make_adapter: Callable[..., Adapter]) -> None:
    t_s, output_V, force_N = stream(600.0)
    adapter = make_adapter()

    rows = adapter.advance(t_s, drifted(output_V, gain=1.0))

    assert rmse(rows.estimate, force_N) < 2 * adapter.take_updates()[0].predicted_rmse
    assert RECALIBRATE not in why(rows.flag)


def test_interval_holds_the_truth_under_drift(make_adapter: Callable[..., Adapter]) -> None:
    t_s, output_V, force_N = stream(600.0)

    rows = make_adapter().advance(t_s, drifted(output_V))

    inside = (rows.lower <= force_N) & (force_N <= rows.upper)
    assert inside[TAPS - 1 :].mean() > 0.85


def test_faulty_rows_are_flagged_and_move_nothing(make_adapter: Callable[..., Adapter]) -> None:
    t_s, output_V, _ = stream(240.0)
    clean = make_adapter()
    clean.advance(t_s, drifted(output_V))
    faulty_t_s, faulty_V = t_s.copy(), drifted(output_V)
    faulty_V[1000] = np.nan
    faulty_V[2000] = np.inf
    faulty_t_s[3000] = faulty_t_s[2999]
    faulty_t_s[4000] = faulty_t_s[3000]
    adapter = make_adapter()

    rows = adapter.advance(faulty_t_s, faulty_V)

    assert why(rows.flag[[1000, 2000, 3000, 4000]]) == [INVALID] * 4
    assert set(why(rows.flag[1001 : 1000 + TAPS])) == {GAP}
    assert np.isnan(rows.estimate[[1000, 1001, 2000, 3000, 4000]]).all()
    assert adapter.current.gain == pytest.approx(clean.current.gain, abs=0.01)
    assert adapter.current.offset == pytest.approx(clean.current.offset, abs=0.01)


def irregular_N(seconds: float, seed: int) -> Array:
    """Presses as the station's random profile makes them: depths, durations and pauses all differ widely."""
    rng = np.random.default_rng(seed)
    force_N: list[Array] = []
    while sum(map(len, force_N)) < seconds * RATE_HZ:
        rise, hold, fall, rest = (round(RATE_HZ * s) for s in rng.uniform(0.15, 1.0, 4))
        shape = [np.linspace(0, 1, rise), np.ones(hold), np.linspace(1, 0, fall), np.zeros(rest)]
        force_N.append(rng.uniform(0.6, 2.0) * np.concatenate(shape))
    return np.concatenate(force_N)[: round(seconds * RATE_HZ)]


def person_N(seconds: float, seed: int) -> Array:
    """Presses of a person: heights and durations scatter by a tenth."""
    rng, nested_list = np.random.default_rng(seed), []
    while sum(map(len, nested_list)) < seconds * RATE_HZ:
        height, length = (1 + 0.1 * rng.normal(size=2)) * (2.0, 1.5)
        nested_list.append(height * np.sin(np.pi * np.arange(0, max(length, 0.7), 1 / RATE_HZ) / max(length, 0.7)) ** 2)
    return np.concatenate(nested_list)[: round(seconds * RATE_HZ)]


@pytest.mark.parametrize("seed", range(6))
def test_a_person_who_goes_on_with_what_a_machine_was_calibrated_with_is_not_followed_as_drift(
    make_adapter: Callable[..., Adapter], seed: int
) -> None:
    force_N = person_N(150.0, seed)
    t_s, output_V = np.arange(len(force_N)) / RATE_HZ, read_V(force_N, seed + 50)

    unfollowed, followed = (make_adapter(mode).advance(t_s, output_V).estimate for mode in ("none", "improved"))

    assert rmse(followed, force_N) <= 1.05 * rmse(unfollowed, force_N)


def test_presses_that_change_in_size_about_a_constant_rest_are_on_hold_without_alarm() -> None:
    force_N = person_N(600.0, 10)
    t_s = np.arange(len(force_N)) / RATE_HZ
    adapter = maker(person_N(90.0, 9))()

    adapter.advance(t_s, read_V(force_N * np.interp(t_s, [200.0, 400.0], [1.0, 1.5]), 6))

    updates = adapter.take_updates()
    assert not any(update.alarm for update in updates)
    assert updates[-1].verdict == "held" and updates[-1].gain == pytest.approx(1.0, abs=0.05)


def test_a_rest_that_follows_lighter_presses_by_the_memory_of_the_sensor_is_no_new_seat() -> None:
    force_N = walk_N(240.0, 5)
    force_N[len(force_N) // 2 :] *= 0.6
    remembered_N, _ = lfilter([1 / 150], [1, 1 / 150 - 1], force_N, zi=[1.0])
    output_V = read_V(force_N, 6) + MEMORY_V_N * remembered_N
    network = replace(exact_network(), output_mean=REST_V + MEMORY_V_N)
    adapter = maker(force_N[:4500], output_V[:4500], network)()

    adapter.advance(np.arange(len(force_N)) / RATE_HZ, output_V)

    updates = adapter.take_updates()
    assert "jumped" not in {update.verdict for update in updates}
    assert (updates[-1].gain, updates[-1].offset) == (pytest.approx(1.0, abs=0.01), pytest.approx(0.0, abs=0.01))


def test_a_preload_that_is_taken_off_is_held_and_no_alarm() -> None:
    force_N = walk_N(240.0, 5) + np.where(np.arange(240 * RATE_HZ) < 120 * RATE_HZ, 1.5, 0.0)
    output_V = read_V(force_N, 6)
    adapter = maker(force_N[:4500], output_V[:4500])()

    rows = adapter.advance(np.arange(len(force_N)) / RATE_HZ, output_V)

    updates = adapter.take_updates()
    assert not any(update.alarm for update in updates)
    assert (updates[-1].gain, updates[-1].offset) == (pytest.approx(1.0, abs=0.01), pytest.approx(0.0, abs=0.01))
    assert rmse(rows.estimate, force_N) < 0.1


@pytest.mark.long
def test_unit_calibrated_by_random_presses_is_followed_in_such_use(make_irregular: Callable[..., Adapter]) -> None:
    force_N = irregular_N(2000.0, 5)
    t_s, output_V = np.arange(len(force_N)) / RATE_HZ, read_V(force_N, 6)
    shift_V = 0.15 * np.clip((t_s - 1000.0) / 300.0, 0, 1)
    last = slice(round(1700.0 * RATE_HZ), None)
    adapter = make_irregular()

    followed = adapter.advance(t_s, output_V + shift_V).estimate

    # Not followed, 0.15 V are 0.6 N.
    assert rmse(followed[last], force_N[last]) < 0.3


@pytest.mark.long
def test_first_use_of_a_unit_without_drift_raises_no_alarm(make_irregular: Callable[..., Adapter]) -> None:
    force_N = irregular_N(900.0, 7)
    t_s, output_V = np.arange(len(force_N)) / RATE_HZ, read_V(force_N, 8)
    adapter = make_irregular()

    rows = adapter.advance(t_s, output_V)

    assert {update.alarm for update in adapter.take_updates()} == {""}
    assert RECALIBRATE not in why(rows.flag)
    assert rmse(rows.estimate, force_N) <= 1.02 * rmse(make_irregular("none").advance(t_s, output_V).estimate, force_N)


def test_first_use_is_said_to_be_unwatched_and_what_moved_in_it_holds_the_map(
    make_irregular: Callable[..., Adapter],
) -> None:
    force_N = irregular_N(1500.0, 7)
    t_s, output_V = np.arange(len(force_N)) / RATE_HZ, read_V(force_N, 8)
    adapter = make_irregular()

    adapter.advance(t_s, output_V + 0.4 * np.minimum(1.0, t_s / 700.0))

    verdicts = [update.verdict for update in adapter.take_updates()]
    assert verdicts[:2] == ["start", "unwatched"]
    assert (verdicts[-1], adapter.current.alarm) == ("held", "")
    assert adapter.current.reason.startswith(MOVED_WHILE_LEARNT)


def test_interval_holds_the_truth_while_the_first_use_is_learnt_and_the_sensor_drifts(
    make_irregular: Callable[..., Adapter],
) -> None:
    force_N = irregular_N(600.0, 7)
    t_s, output_V = np.arange(len(force_N)) / RATE_HZ, read_V(force_N, 8)

    rows = make_irregular().advance(t_s, output_V + 0.3 * np.minimum(1.0, t_s / 300.0))

    inside = (rows.lower <= force_N) & (force_N <= rows.upper)
    assert set(state(rows.flag)) == {"unwatched", "held"}
    assert rmse(rows.estimate, force_N) > 0.5
    assert inside[TAPS:].mean() > 0.85


def test_use_that_stays_unknown_is_held_after_the_first_day(make_irregular: Callable[..., Adapter]) -> None:
    """A second stream of one-sided ramps, never twice alike, two days long in time stamps of one sample a second."""
    learning = replace(DriftTracking().learning, first_operation_s=300.0)
    adapter = make_irregular(method=replace(DriftTracking(), learning=learning))
    # Steps of a random walk: no eight of its cycles are like eight others.
    walk = np.cumsum(np.random.default_rng(9).normal(0, 0.02, 30_000))
    force_N = 1.0 + np.abs((walk + 1) % 4 - 2)

    adapter.advance(np.arange(len(force_N)) / RATE_HZ, read_V(force_N, 10))

    assert (adapter.current.verdict, adapter.current.alarm) == ("held", "")
    assert (adapter.current.gain, adapter.current.offset) == (1.0, 0.0)


def test_dropped_samples_and_long_gaps_leave_estimates_out_until_a_window_is_full(
    make_adapter: Callable[..., Adapter],
) -> None:
    t_s, output_V, _ = stream(60.0)
    is_kept_row = np.ones(len(t_s), dtype=bool)
    is_kept_row[500] = is_kept_row[1000:1700] = False

    rows = make_adapter().advance(t_s[is_kept_row], output_V[is_kept_row])

    assert set(why(rows.flag[: TAPS - 1])) == {WARM_UP}
    assert set(why(rows.flag[500 : 500 + TAPS - 1])) == {GAP}
    assert set(why(rows.flag[999 : 999 + TAPS - 1])) == {GAP}
    assert why(rows.flag[999 + TAPS - 1 :])[0] == ""


def test_change_of_rate_is_flagged(make_adapter: Callable[..., Adapter]) -> None:
    t_s, output_V, _ = stream(60.0)
    t_s = np.concatenate([t_s[:1000], t_s[999] + (1 + np.arange(2000)) / 80.0])
    adapter = make_adapter()

    rows = adapter.advance(t_s, output_V)

    assert set(why(rows.flag[1000 + TAPS :])) == {WRONG_RATE}
    assert adapter.current.gain == 1.0


def test_clock_that_restarts_goes_on_after_a_stated_number_of_rows(make_adapter: Callable[..., Adapter]) -> None:
    t_s, output_V, _ = stream(60.0)
    t_s = np.concatenate([1000 + t_s[:1500], t_s[1500:] - t_s[1500]])

    rows = make_adapter().advance(t_s, output_V)

    assert set(why(rows.flag[1500 : 1500 + TAPS - 1])) == {INVALID}
    assert why(rows.flag[1500 + TAPS + TAPS :])[0] == ""


def test_every_row_says_whether_its_map_is_unwatched_held_or_followed(make_adapter: Callable[..., Adapter]) -> None:
    t_s, output_V, _ = stream(240.0)
    harder_V = np.where(t_s > 120.0, REST_V + 1.5 * (output_V - REST_V), output_V)

    usual, harder = (make_adapter().advance(t_s, values).flag for values in (output_V, harder_V))

    assert set(state(usual[:50])) == {"unwatched"} and set(state(usual[200:])) == {"followed"}
    assert "held" in state(harder[6100:])
    assert set(make_adapter("none").advance(t_s, output_V).flag[TAPS:]) == {""}


def test_stuck_sensor_is_held_and_alarmed(make_adapter: Callable[..., Adapter]) -> None:
    t_s, output_V, _ = stream(120.0)
    output_V[3000:] = output_V[3000]
    adapter = make_adapter()

    rows = adapter.advance(t_s, output_V)

    assert why(rows.flag)[-1] == STUCK
    assert adapter.current.alarm
    assert (adapter.current.gain, adapter.current.offset) == (1.0, 0.0)


def test_rows_after_a_sudden_change_are_flagged_until_it_is_followed(make_adapter: Callable[..., Adapter]) -> None:
    t_s, output_V, force_N = stream(120.0)
    seated = np.where(t_s < 60.0, output_V, 0.95 * output_V + 0.15)

    rows = make_adapter().advance(t_s, seated)

    after = 3000
    assert UNSETTLED in why(rows.flag[after : after + 200])
    assert rmse(rows.estimate[after + 400 :], force_N[after + 400 :]) < 0.04


def test_unsafe_drift_flags_the_rows_as_due_for_recalibration(make_adapter: Callable[..., Adapter]) -> None:
    t_s, output_V, _ = stream(120.0)
    adapter = make_adapter()
    adapter.advance(t_s, output_V)

    rows = adapter.advance(120.0 + t_s, output_V + 0.6)

    assert adapter.current.alarm
    assert adapter.current.predicted_rmse > 0.1
    assert {RECALIBRATE, "out of range"} & set(why(rows.flag[-200:]))


def test_rows_are_unsettled_where_the_predicted_error_has_doubled_and_no_alarm_stands(
    make_adapter: Callable[..., Adapter],
) -> None:
    """An alarm over a drift that is followed well is a false one; rows without a word would hide what is not known."""
    t_s, output_V, force_N = stream(600.0)
    adapter, observed = make_adapter(), []
    shifted_V = drifted(output_V, 1.0, 0.15)
    predicted_rmse = adapter.current.predicted_rmse

    for k in range(0, len(t_s), DriftTracking().stream.batch):
        is_doubled = adapter.current.predicted_rmse > 2 * predicted_rmse
        piece = slice(k, k + DriftTracking().stream.batch)
        observed.append((is_doubled, adapter.advance(t_s[piece], shifted_V[piece])))

    assert not any(update.alarm for update in adapter.take_updates())
    flags = [({*why(rows.flag)} & {"", UNSETTLED, RECALIBRATE}, is_doubled) for is_doubled, rows in observed[2:]]
    assert {is_doubled for _, is_doubled in flags} == {False, True}
    assert all(flags_of_row <= ({UNSETTLED} if is_doubled else {"", UNSETTLED}) for flags_of_row, is_doubled in flags)
    followed = np.concatenate([rows.estimate for _, rows in observed])
    assert rmse(followed, force_N) < 0.25 * rmse(shifted_V, output_V) / GAIN_V_N


def test_restart_from_the_kept_state_gives_the_same_rows(make_adapter: Callable[..., Adapter]) -> None:
    t_s, output_V, _ = stream(120.0)
    output_V = drifted(output_V)
    cut = 2345
    first, second = make_adapter(), make_adapter()
    whole = make_adapter().advance(t_s, output_V)
    first.advance(t_s[:cut], output_V[:cut])

    second.restore(json.loads(json.dumps(first.state())))

    rows = second.advance(t_s[cut:], output_V[cut:])
    np.testing.assert_array_equal(rows.estimate, whole.estimate[cut:])
    np.testing.assert_array_equal(rows.lower, whole.lower[cut:])


def test_a_state_of_another_format_is_refused(make_adapter: Callable[..., Adapter]) -> None:
    adapter = make_adapter()
    before = adapter.state()

    for other in (STATE_FORMAT + 1, None):
        with pytest.raises(InputError, match=rf"\b{other}\b.*\b{STATE_FORMAT}\b"):
            adapter.restore(before | {"format": other})

    assert adapter.state() == before


def test_state_once_taken_does_not_change_while_the_stream_goes_on(make_adapter: Callable[..., Adapter]) -> None:
    t_s, output_V, _ = stream(60.0)
    adapter = make_adapter()
    adapter.advance(t_s[:1234], output_V[:1234])
    state = adapter.state()
    batch_windows = json.dumps(state)

    adapter.advance(t_s[1234:], output_V[1234:])

    assert json.dumps(state) == batch_windows


def test_state_does_not_grow(make_adapter: Callable[..., Adapter]) -> None:
    t_s, output_V, _ = stream(400.0)
    adapter = make_adapter()
    sizes = []

    for k in range(0, len(t_s), 4000):
        adapter.advance(t_s[k : k + 4000], output_V[k : k + 4000])
        sizes.append(len(json.dumps(adapter.state())))

    assert sizes[-1] < 1.5 * sizes[1]


def test_updates_say_what_was_seen_and_are_handed_over_once(make_adapter: Callable[..., Adapter]) -> None:
    t_s, output_V, _ = stream(300.0)
    adapter = make_adapter()
    adapter.advance(t_s, drifted(output_V))

    updates = adapter.take_updates()

    assert updates[0].verdict == "start"
    assert updates[-1].gain > 1.05
    assert [update.row for update in updates] == sorted(update.row for update in updates)
    assert adapter.take_updates() == []
