"""What holds a map and what raises an alarm: not how far a drift has gone, but what of it is open or wrong."""

from dataclasses import replace

import numpy as np
import pytest

from softcal.core.use.doubt import JUMP, LATE, MISSED, OPEN, STRAY, UNCOMPARED, Doubt, Evidence, doubt
from softcal.core.use.method import DoubtConfig

CONFIG = DoubtConfig()
NOTHING = Evidence(
    drift=np.zeros(2),
    applied=np.zeros(2),
    chance=0.001,
    walked=0.0,
    moved=0.0,
    use_share=0.5,
    use_doubt=0.0,
    preload_doubt=0.0,
    unseen=0.0,
    is_learning=False,
    unresolved=0.0,
    missed=0.0,
    stray=0.0,
    lag=0.0,
)


def all_of(found: Doubt) -> dict[str, float]:
    return {**found.of_use, **found.of_map}


def counted(seen: Evidence) -> float:
    return float(np.sqrt(sum(all_of(doubt(seen, CONFIG)).values())))


def test_a_drift_that_is_applied_in_full_counts_a_small_share_of_its_size() -> None:
    drift = np.array([0.8, 0.0])

    followed = counted(replace(NOTHING, drift=drift, applied=drift))

    assert followed <= 0.05 * 0.8
    assert doubt(replace(NOTHING, drift=drift, applied=drift), CONFIG).growth > 3 * followed


@pytest.mark.parametrize(
    ("why", "is_of_use", "change"),
    [
        (UNCOMPARED, True, {"unseen": 1.0}),
        (MISSED, True, {"missed": 0.3}),
        (STRAY, True, {"stray": 0.3}),
        (JUMP, True, {"unresolved": 0.3}),
        (OPEN, True, {"drift": np.array([0.0, 0.3])}),
        (OPEN, True, {"lag": 0.3}),
        (LATE, False, {"lag": 0.5, "drift": np.array([0.3, 0.0]), "applied": np.array([0.3, 0.0])}),
    ],
)
def test_what_may_be_use_holds_and_what_is_wrong_alarms(why: str, is_of_use: bool, change: dict[str, object]) -> None:
    found = doubt(replace(NOTHING, **change), CONFIG)  # type: ignore[arg-type]

    squares = all_of(found)
    assert max(squares, key=squares.__getitem__) == why
    assert squares[why] > max(0.01, 0.99 * sum(squares.values()))
    assert (why in found.of_use) == is_of_use


def test_a_drift_within_chance_counts_nothing() -> None:
    assert counted(replace(NOTHING, drift=np.array([0.02, 0.02]))) == 0


def test_use_not_compared_widens_the_interval_but_counts_only_once_the_first_use_is_over() -> None:
    learning = doubt(replace(NOTHING, unseen=1.0, is_learning=True), CONFIG)
    later = doubt(replace(NOTHING, unseen=1.0), CONFIG)

    assert learning.widening == later.widening >= CONFIG.unseen
    assert (learning.growth, sum(all_of(learning).values())) == (0.0, 0.0)
    assert later.growth == pytest.approx(CONFIG.unseen)
