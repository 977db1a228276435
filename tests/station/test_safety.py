"""The watches of a run on made-up streams: what a line may do to healthy samples, and how a dead channel looks."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softcal.core.errors import BadReply
from softcal.station.config import SafetyConfig
from softcal.station.interfaces import Readout, Sample
from softcal.station.safety import FROZEN_MM, StreamWatch

RATE_HZ = 50.0
STALL_S = 0.1
"""Longest stall that a healthy line is allowed."""

READOUT = cast(Readout, SimpleNamespace(name="sensor readout", unit="V", rate_Hz=RATE_HZ))


def pressed_until_raised(speed_mm_s: float, slope_V_mm: float, lsb_V: float, seed: int) -> float | None:
    """Press 3 mm deep past a watch, lines held back by stalls; return the depth at which it raised, if it did."""
    rng, watch = np.random.default_rng(seed), StreamWatch(READOUT, SafetyConfig(), 0.0)
    taken_s = np.arange(0.0, 3.0 / speed_mm_s, 1.0 / RATE_HZ)
    seen_s = taken_s + 0.001
    for k in range(len(seen_s)):
        if rng.random() < 0.1:
            seen_s[k:] = np.maximum(seen_s[k:], taken_s[k] + rng.uniform(0.0, STALL_S))
    for at_s, host_s in zip(taken_s, seen_s, strict=True):
        level = round((1.0 + slope_V_mm * speed_mm_s * at_s) / lsb_V) * lsb_V
        try:
            watch.check(Sample(float(host_s), float(at_s), (level,)), speed_mm_s * float(host_s))
        except BadReply:
            return speed_mm_s * float(host_s)
    return None


@given(speed_mm_s=st.floats(0.5, 6.0), seed=st.integers(0, 2**31))
def test_samples_that_a_stall_held_back_are_not_taken_for_a_frozen_channel(speed_mm_s: float, seed: int) -> None:
    # The converter's step is the output's change over a fifth of a millimetre: neighbours are often equal.
    assert pressed_until_raised(speed_mm_s, slope_V_mm=0.05, lsb_V=0.01, seed=seed) is None


@given(speed_mm_s=st.floats(0.5, 6.0), seed=st.integers(0, 2**31))
def test_a_channel_that_never_changes_is_frozen(speed_mm_s: float, seed: int) -> None:
    raised_mm = pressed_until_raised(speed_mm_s, slope_V_mm=0.0, lsb_V=0.01, seed=seed)
    assert raised_mm is not None
    # The first line may come late, and the one that tells as well.
    assert raised_mm <= FROZEN_MM + speed_mm_s * (2 * STALL_S + 2 / RATE_HZ)


def test_one_late_line_is_no_frozen_channel() -> None:
    watch = StreamWatch(READOUT, SafetyConfig(), 0.0)
    watch.check(Sample(1.00, 1.00, (1.559,)), 1.00)
    watch.check(Sample(1.13, 1.02, (1.559,)), 1.65)
    with pytest.raises(BadReply, match="does not change"):
        for k in range(10):
            watch.check(Sample(1.13 + 0.02 * k, 1.04 + 0.02 * k, (1.559,)), 1.65)
