"""What holds a map, and how wrong its correction may be: not how far a drift has gone, but what of it is open."""

from dataclasses import replace

import numpy as np
import pytest

from softcal.core.operation.method import UncertaintyConfig
from softcal.core.operation.uncertainty import (
    JUMP,
    MOVED_WHILE_LEARNT,
    OPEN,
    REST_ELSEWHERE,
    UNCOMPARED,
    DriftEvidence,
    estimate_uncertainty,
)

CONFIG = UncertaintyConfig()
NOTHING = DriftEvidence(
    drift=np.zeros(2),
    applied_drift=np.zeros(2),
    variance=0.001,
    process_variance=0.0,
    rest_path=0.0,
    operation_variance=0.0,
    unobserved=0.0,
    is_learning=False,
    unexplained_jump=0.0,
    learning_shift=0.0,
    rest_offset=0.0,
    lag=0.0,
)


def counted(evidence: DriftEvidence) -> float:
    return float(np.sqrt(sum(estimate_uncertainty(evidence, CONFIG).ambiguous.values())))


def test_a_drift_that_is_applied_in_full_holds_nothing_and_its_uncertainty_grows_with_its_size() -> None:
    small, large = (replace(NOTHING, drift=d, applied_drift=d) for d in (np.array([0.4, 0.0]), np.array([0.8, 0.0])))

    assert counted(large) == 0.0
    assert (
        estimate_uncertainty(small, CONFIG).error_inflation < estimate_uncertainty(large, CONFIG).error_inflation < 0.4
    )


def test_a_correction_that_is_behind_is_doubted_by_how_far() -> None:
    drift = np.array([0.3, 0.0])
    level = replace(NOTHING, drift=drift, applied_drift=drift)

    behind = estimate_uncertainty(replace(level, lag=0.5), CONFIG)

    assert behind.error_inflation**2 - estimate_uncertainty(level, CONFIG).error_inflation ** 2 == pytest.approx(0.5**2)
    assert sum(behind.ambiguous.values()) == 0.0


@pytest.mark.parametrize(
    ("why", "change"),
    [
        (UNCOMPARED, {"unobserved": 0.2}),
        (MOVED_WHILE_LEARNT, {"learning_shift": 0.3}),
        (REST_ELSEWHERE, {"rest_offset": 0.3}),
        (JUMP, {"unexplained_jump": 0.3}),
        (OPEN, {"drift": np.array([0.0, 0.3])}),
        (OPEN, {"lag": 0.3}),
    ],
)
def test_what_may_be_use_holds(why: str, change: dict[str, object]) -> None:
    squares = estimate_uncertainty(replace(NOTHING, **change), CONFIG).ambiguous  # type: ignore[arg-type]

    assert max(squares, key=squares.__getitem__) == why
    assert squares[why] > max(0.01, 0.99 * sum(squares.values()))


def test_a_drift_within_chance_counts_nothing() -> None:
    assert counted(replace(NOTHING, drift=np.array([0.02, 0.02]))) == 0


def test_use_not_compared_widens_the_interval_but_counts_only_once_the_first_use_is_over() -> None:
    learning = estimate_uncertainty(replace(NOTHING, unobserved=0.2, is_learning=True), CONFIG)
    later = estimate_uncertainty(replace(NOTHING, unobserved=0.2), CONFIG)

    assert learning.interval_inflation == later.interval_inflation >= 0.2
    assert (learning.error_inflation, sum(learning.ambiguous.values())) == (0.0, 0.0)
    assert later.error_inflation == pytest.approx(0.2)
