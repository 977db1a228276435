"""Safety monitors of force and channels, checked at every sample of a state that activates them. No motion here.

`watched.py` asks them, and itself checks what also needs the stage: depth, a force in the way of the approach, and one
that rises while the stage homes.
"""

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from softcal.core.errors import BadReply, NoReply, SafetyStop
from softcal.core.messages.reason import reason
from softcal.station.clock import CLOCK_SHARE
from softcal.station.device_names import device_label
from softcal.station.devices.config import SafetyConfig
from softcal.station.interfaces import ForceReader, Readout, Sample

PRESSED_MM, MISSING_S, RISEN_MM = 0.8, 0.15, 0.1
"""A unit pressed this deep for so long must show a force; but not where the stage has risen this far since it did: a
unit that relaxes comes back slowly."""

SUDDEN_N, LASTS_S = 1.0, 0.25
"""A force that grows by this much while the stage homes, or from one sample to the next while it stands, is none of the
unit's. What lasts so long (a stage that stands, a reading at its rail, lines that come late) is no accident."""

STUCK_MM, STUCK_OUTPUT_MM, FROZEN, STUCK_MEAN_S, STUCK_NOISES, STUCK_SAMPLES = 1.2, 1.6, 0.6, 0.1, 6.0, 6
"""The mean over so long must change by this many times its noise while the stage moves so far on the unit (a load cell,
a sensor's output); over this share of the way it must change at all. A slow channel has few samples in a fast press:
from fewer than these nothing is said."""

LAGS_S = (0.1, 0.3)
"""An output may lag (an RC filter, a slow sensor): where the stage turns it stands still for a moment. A stage that
lags as much must have moved by the share FROZEN of the way, too."""

SLOPE_SAMPLES = 4
RATE_SAMPLES, MISSED_SAMPLES = 50, 4
"""When more are missing, or too many, among so many samples, the device has another rate or its wire loses lines."""


class ForceMonitor:
    """Force limit of one load cell, which reads `zero_N` without a load.

    `ahead_s` is to be kept up to date: for how long the force may still grow at its present rate, until the stage has
    been stopped or has ended its move.
    """

    def __init__(self, bounds: SafetyConfig) -> None:
        self._bounds, self.zero_N, self.ahead_s = bounds, 0.0, 0.0
        self._recent: deque[tuple[float, float]] = deque(maxlen=SLOPE_SAMPLES)

    def check(self, sample: Sample) -> None:
        """Raise `SafetyStop` when the force is above the limit, or will be before the stage brakes."""
        force_N = sample.values[0] - self.zero_N
        time_s = sample.host_s if sample.device_s is None else sample.device_s
        self._recent.append((time_s, force_N))
        (first_s, first_N), slope_N_s = self._recent[0], 0.0
        if len(self._recent) == SLOPE_SAMPLES and time_s > first_s:
            slope_N_s = (force_N - first_N) / (time_s - first_s)
        coming_N = force_N + max(0.0, slope_N_s) * self.ahead_s
        if max(coming_N, -force_N) > self._bounds.force_N:
            raise SafetyStop(reason("rig.force", force_N=force_N, coming_N=coming_N, limit_N=self._bounds.force_N))


class FollowMonitor:
    """Whether there is a force where the stage presses."""

    def __init__(self, contact_N: float) -> None:
        self._contact_N = contact_N
        self._missing_since_s: float | None = None
        self._loaded_mm, self._turned_mm = 0.0, math.inf
        """Deepest with a force since the stage was last above the contact; shallowest since without."""

    def check(self, force_N: float, pressed_mm: float, now_s: float) -> None:
        """Raise `BadReply` when a stage well below the contact meets no force for a while."""
        is_loaded = force_N > self._contact_N
        if is_loaded:
            self._loaded_mm, self._turned_mm = max(self._loaded_mm, pressed_mm), math.inf
        else:
            self._loaded_mm = self._loaded_mm if pressed_mm > 0.0 else 0.0
            self._turned_mm = min(self._turned_mm, pressed_mm)
        may_be_slow = pressed_mm < self._loaded_mm - RISEN_MM and pressed_mm < self._turned_mm + PRESSED_MM
        if is_loaded or pressed_mm < PRESSED_MM or may_be_slow:
            self._missing_since_s = None
        elif self._missing_since_s is None:
            self._missing_since_s = now_s
        elif now_s - self._missing_since_s > MISSING_S:
            raise BadReply(reason("rig.no_force", force_N=force_N, pressed_mm=pressed_mm))


class JumpMonitor:
    """Whether the force jumps while nothing moves: a cable, an amplifier, or a hand at the rig."""

    def __init__(self) -> None:
        self._last_N: float | None = None
        self._moved_s = 0.0

    def check(self, force_N: float, is_moving: bool, now_s: float, latest_s: float) -> None:
        """Raise `BadReply` if two successive samples differ by more than a unit at rest allows.

        The sample may be `latest_s` late, so the stage must have been at rest for that long, too.
        """
        if is_moving:
            self._moved_s = now_s
        last_N, self._last_N = self._last_N, force_N
        has_stood = now_s - self._moved_s > LASTS_S + latest_s
        if last_N is not None and has_stood and abs(force_N - last_N) > SUDDEN_N:
            raise BadReply(reason("rig.jump", before_N=last_N, after_N=force_N))


class StuckMonitor:
    """Monitor of a channel that must follow the stage: frozen value, stuck cell, motor without supply.

    Args:
        noise: standard deviation of the channel while nothing is pressed; 0 where any change will do.
        stuck_mm: how far the stage may move on the unit before the channel must follow.
        lags_s: time constants with which the channel may follow.
    """

    def __init__(
        self, name: str, noise: float, rate_Hz: float, stuck_mm: float = STUCK_MM, lags_s: Sequence[float] = ()
    ) -> None:
        self._stuck_mm = stuck_mm
        self._gains = np.array([1.0, *(-math.expm1(-1.0 / (rate_Hz * lag_s)) for lag_s in lags_s)])
        self._lagging_mm = np.zeros(len(self._gains))
        self._min_ways_mm = stuck_mm * np.array([1.0] + [FROZEN] * len(lags_s))
        averaged = max(1, round(STUCK_MEAN_S * rate_Hz)) if noise else 1
        self._name, self._min_change = name, STUCK_NOISES * noise / np.sqrt(averaged)
        self._recent: deque[float] = deque(maxlen=averaged)
        self._restart()

    def _restart(self) -> None:
        self._count, self._low, self._high = 0, math.inf, -math.inf
        self._shallow_mm, self._deep_mm = np.full((2, len(self._gains)), [[math.inf], [-math.inf]])

    def check(self, value: float, pressed_mm: float) -> None:
        """Raise `BadReply` when the stage moved far on the unit and the channel has not followed."""
        self._recent.append(value)
        self._lagging_mm += self._gains * (pressed_mm - self._lagging_mm)
        if pressed_mm <= 0.0:
            self._restart()
            return
        if len(self._recent) < (self._recent.maxlen or 1):
            return
        self._count += 1
        mean = math.fsum(self._recent) / len(self._recent)
        self._low, self._high = min(self._low, mean), max(self._high, mean)
        self._shallow_mm = np.minimum(self._shallow_mm, self._lagging_mm)
        self._deep_mm = np.maximum(self._deep_mm, self._lagging_mm)
        if self._high - self._low > self._min_change:
            self._restart()
        elif np.all(self._deep_mm - self._shallow_mm > self._min_ways_mm) and self._count >= STUCK_SAMPLES:
            raise BadReply(reason("rig.stuck", device=device_label(self._name), level=mean, stuck_mm=self._stuck_mm))


class StreamMonitor:
    """Monitor of a stream: silence and sample rate.

    Args:
        rails: lowest and highest possible value of a readout, where staying there means a broken wire.
    """

    def __init__(
        self,
        reader: ForceReader | Readout,
        bounds: SafetyConfig,
        now_s: float,
        rails: tuple[float, float] | None = None,
    ) -> None:
        self._reader, self._bounds, self._rails = reader, bounds, rails
        self._newest_s = now_s
        self._times: deque[float] = deque(maxlen=RATE_SAMPLES)
        self._on_rail_since_s: float | None = None
        self._earliest_s, self._old_since_s = float("inf"), float("inf")
        self._resumed_s = float("-inf")

    def resume(self, now_s: float) -> None:
        """Restart the count after a stall of the host, which reads buffered samples late."""
        self._newest_s = self._resumed_s = now_s
        self._old_since_s, self._on_rail_since_s = float("inf"), None

    def check(self, sample: Sample) -> None:
        """Raise `BadReply` for a channel at its rail or at another rate; `NoReply` for an old sample."""
        self._newest_s = sample.host_s
        low, high = self._rails or (0.0, 0.0)
        if self._rails is None or not any(value <= low or value >= high for value in sample.values):
            self._on_rail_since_s = None
        elif self._on_rail_since_s is None:
            self._on_rail_since_s = sample.host_s
        elif sample.host_s - self._on_rail_since_s > LASTS_S:
            raise BadReply(reason("rig.rail", device=device_label(self._reader.name), rail_s=LASTS_S))
        if (device_s := sample.device_s) is None:
            return
        self._times.append(device_s)
        count, span_s, rate_Hz = len(self._times), device_s - self._times[0], self._reader.rate_Hz
        if abs(round(span_s * rate_Hz) + 1 - count) > MISSED_SAMPLES:
            name = device_label(self._reader.name)
            raise BadReply(reason("rig.rate", device=name, count=count, span_s=span_s, rate_Hz=rate_Hz))
        # A line may begin to hold readings back: they are old by the earliest ones of before.
        allowed_s = CLOCK_SHARE * (device_s - self._times[-2]) if len(self._times) > 1 else 0.0
        self._earliest_s = min(self._earliest_s + allowed_s, sample.host_s - device_s)
        age_s = sample.host_s - device_s - self._earliest_s
        if age_s <= LASTS_S or sample.host_s <= self._resumed_s + LASTS_S:
            self._old_since_s = float("inf")
        self._old_since_s = min(self._old_since_s, device_s)
        if age_s > LASTS_S and device_s - self._old_since_s > LASTS_S:
            raise NoReply(reason("rig.old", device=device_label(self._reader.name), age_s=age_s))

    def check_silence(self, now_s: float) -> None:
        """Raise `NoReply` when no sample came for too long."""
        if now_s - self._newest_s > self._bounds.silence_s:
            raise NoReply(reason("rig.silent", device=device_label(self._reader.name), seconds=now_s - self._newest_s))
