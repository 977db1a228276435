"""What holds a map, and how wrong its correction may be: not how far a drift has gone, but what of it is open."""

from dataclasses import replace

import numpy as np
import pytest

from softcal.core.use.doubt import JUMP, MISSED, OPEN, STRAY, UNCOMPARED, Evidence, doubt
from softcal.core.use.method import DoubtConfig

CONFIG = DoubtConfig()
NOTHING = Evidence(
    drift=np.zeros(2),
    applied=np.zeros(2),
    chance=0.001,
    walked=0.0,
    moved=0.0,
    use_doubt=0.0,
    unseen=0.0,
    is_learning=False,
    unresolved=0.0,
    missed=0.0,
    stray=0.0,
    lag=0.0,
)


def counted(seen: Evidence) -> float:
    return float(np.sqrt(sum(doubt(seen, CONFIG).of_use.values())))


def test_a_drift_that_is_applied_in_full_holds_nothing_and_its_doubt_grows_with_its_size() -> None:
    small, large = (replace(NOTHING, drift=d, applied=d) for d in (np.array([0.4, 0.0]), np.array([0.8, 0.0])))

    assert counted(large) == 0.0
    assert doubt(small, CONFIG).growth < doubt(large, CONFIG).growth < 0.4


def test_a_correction_that_is_behind_is_doubted_by_how_far() -> None:
    drift = np.array([0.3, 0.0])
    level = replace(NOTHING, drift=drift, applied=drift)

    behind = doubt(replace(level, lag=0.5), CONFIG)

    assert behind.growth**2 - doubt(level, CONFIG).growth ** 2 == pytest.approx(0.5**2)
    assert sum(behind.of_use.values()) == 0.0


@pytest.mark.parametrize(
    ("why", "change"),
    [
        (UNCOMPARED, {"unseen": 0.2}),
        (MISSED, {"missed": 0.3}),
        (STRAY, {"stray": 0.3}),
        (JUMP, {"unresolved": 0.3}),
        (OPEN, {"drift": np.array([0.0, 0.3])}),
        (OPEN, {"lag": 0.3}),
    ],
)
def test_what_may_be_use_holds(why: str, change: dict[str, object]) -> None:
    squares = doubt(replace(NOTHING, **change), CONFIG).of_use  # type: ignore[arg-type]

    assert max(squares, key=squares.__getitem__) == why
    assert squares[why] > max(0.01, 0.99 * sum(squares.values()))


def test_a_drift_within_chance_counts_nothing() -> None:
    assert counted(replace(NOTHING, drift=np.array([0.02, 0.02]))) == 0


def test_use_not_compared_widens_the_interval_but_counts_only_once_the_first_use_is_over() -> None:
    learning = doubt(replace(NOTHING, unseen=0.2, is_learning=True), CONFIG)
    later = doubt(replace(NOTHING, unseen=0.2), CONFIG)

    assert learning.widening == later.widening >= 0.2
    assert (learning.growth, sum(learning.of_use.values())) == (0.0, 0.0)
    assert later.growth == pytest.approx(0.2)
