"""Checks of a load cell and a readout: correct readings in time, and never a false reading."""

from collections.abc import Callable, Sequence

import numpy as np

from softcal.station.interfaces import Sample
from softcal.station.testing.rig import DriverRig, require

RATE_SHARE = 0.05
LATEST_S, EARLIEST_S = 0.25, 0.02
"""A reading may show what was so long before its line came, and never what came later."""

DETECTION_S, FAULTY_SHARE = 1.0, 0.33
SPAN_V = 5.0


def _unit_per_level(rig: DriverRig) -> float:
    return rig.simulated.reading_per_V if rig.driver.role == "readout" else 1.0


def _tolerance(rig: DriverRig) -> float:
    span = SPAN_V * abs(_unit_per_level(rig)) if rig.driver.role == "readout" else float(rig.config.capacity_N)
    return 0.005 * span


def _levels(rig: DriverRig) -> tuple[float, ...]:
    if rig.driver.role == "readout":
        return (0.5, 1.0, 2.5, 4.5, 0.5)
    capacity_N = float(rig.config.capacity_N)
    return (0.0, 0.02 * capacity_N, 0.25 * capacity_N, 0.6 * capacity_N, -0.05 * capacity_N, 0.0)


def _check_true(rig: DriverRig, samples: Sequence[Sample], level: float, when: str) -> None:
    expected, allowed = level * _unit_per_level(rig), _tolerance(rig)
    for sample in samples:
        off = max(abs(value - expected) for value in sample.values)
        require(off <= allowed, f"{when} it reads {sample.values}, {expected:g} give or take {allowed:g} is true")


def _declares_identity(rig: DriverRig) -> None:
    reader = rig.reader()
    require(reader.name and reader.unit and reader.rate_Hz > 0, "name, unit and rate_Hz must say what it is")
    if rig.driver.role == "cell":
        require(reader.unit == "N", f"a load cell reads in N, not {reader.unit}")
        require(getattr(reader, "capacity_N", 0) == rig.config.capacity_N, "capacity_N must be that of the file")
        return
    low, high = getattr(reader, "range", (0.0, 0.0))
    require(low < high, f"range must be (lowest, highest) possible reading, not {(low, high)}")
    require(getattr(reader, "channels", 0) == rig.config.channels, "channels must be those of the file")


def _reads_every_level(rig: DriverRig) -> None:
    reader = rig.reader()
    for level in _levels(rig):
        rig.level = level
        rig.collect(reader, 0.5)
        samples = rig.collect(reader, 0.5)
        require(samples, f"no sample within 0.5 s at {level:g}")
        require(len(samples[0].values) == getattr(reader, "channels", 1), "one number per channel was expected")
        _check_true(rig, samples, level, f"at {level:g}")


def _reads_in_time(rig: DriverRig) -> None:
    reader = rig.reader()
    rig.level = 0.0
    rig.collect(reader, 0.5)
    per_s = 0.2 * (SPAN_V if rig.driver.role == "readout" else float(rig.config.capacity_N))
    began_world_s, began_s = rig.world.now_s(), rig.clock.now_s()
    rig.level = lambda now_s: per_s * max(0.0, now_s - began_world_s)
    allowed = _tolerance(rig)
    for sample in rig.collect(reader, 2.0):
        newest = per_s * (sample.host_s + EARLIEST_S - began_s) * _unit_per_level(rig) + allowed
        oldest = per_s * max(0.0, sample.host_s - LATEST_S - began_s) * _unit_per_level(rig) - allowed
        require(
            oldest <= sample.values[0] <= newest,
            f"{sample.host_s - began_s:.3f} s into a ramp it reads {sample.values[0]:.5g}; {oldest:.5g} to "
            f"{newest:.5g} is possible",
        )


def _check_rate(rig: DriverRig) -> None:
    reader = rig.reader()
    seconds = 4.0
    samples = rig.collect(reader, seconds)
    rate_Hz = len(samples) / seconds
    require(
        abs(rate_Hz / reader.rate_Hz - 1) < RATE_SHARE,
        f"{rate_Hz:.1f} samples a second, {reader.rate_Hz:g} declared",
    )
    require(all(np.isfinite(sample.values).all() for sample in samples), "a sample that is no number")
    _check_times(samples)


def _check_times(samples: Sequence[Sample]) -> None:
    host_s = [sample.host_s for sample in samples]
    require(all(np.diff(host_s) >= 0), "host times go back: oldest first was expected")
    device_s = [sample.device_s for sample in samples if sample.device_s is not None]
    require(len(device_s) in (0, len(samples)), "some samples have a device time and some have none")
    require(all(np.diff(device_s) > 0), "device times must increase: a repeated line is no sample")


def _starts_anew(rig: DriverRig) -> None:
    first, _, last, *_ = _levels(rig)
    reader = rig.reader()
    rig.level = first
    rig.collect(reader, 0.3)
    rig.clock.sleep_s(0.5)  # Nobody reads: readings pile up.
    rig.level = last
    rig.clock.sleep_s(0.5)
    reader.start()
    samples = rig.collect(reader, 0.5)
    require(samples, "no sample within 0.5 s of start()")
    _check_true(rig, samples, last, "after start()")


def _is_silent_with_its_device(rig: DriverRig) -> None:
    reader = rig.reader()
    rig.wire.is_silent = True
    silent_s = rig.clock.now_s()
    samples, _ = rig.fault_within(2.0, reader.poll)
    late = [sample for sample in samples if sample.host_s > silent_s + LATEST_S]
    require(not late, f"its device is silent, and it delivers {len(late)} samples, the first {late[:1]}")


def _invents_nothing(fault: str) -> Callable[[DriverRig], None]:
    def examine(rig: DriverRig) -> None:
        _, _, level, *_ = _levels(rig)
        reader = rig.reader()
        rig.level = level
        rig.collect(reader, 0.5)
        setattr(rig.wire, fault, FAULTY_SHARE)
        samples, _ = rig.fault_within(3.0, reader.poll)
        _check_true(rig, samples, level, f"with {fault} {FAULTY_SHARE:g} on its line")
        _check_times(samples)

    return examine


def _is_deaf_to_noise(rig: DriverRig) -> None:
    reader = rig.reader()
    rig.wire.garbage = 1.0
    rig.clock.sleep_s(LATEST_S)
    _, error = rig.fault_within(LATEST_S, reader.poll)
    if error is None:
        samples, _ = rig.fault_within(3.0, reader.poll)
        require(not samples, f"of nothing but noise it made {len(samples)} samples, the first {samples[:1]}")


def _detects_lost_device(rig: DriverRig) -> None:
    reader = rig.reader()
    rig.wire.unplug()
    _, error = rig.fault_within(DETECTION_S, reader.poll)
    require(error is not None, f"its device is gone, and for {DETECTION_S:g} s nothing is said")


READER: dict[str, Callable[[DriverRig], None]] = {
    "it declares name, unit, rate and range": _declares_identity,
    "every level is read, in its unit": _reads_every_level,
    "a ramp is read in time": _reads_in_time,
    "it keeps its rate, and its times go forward": _check_rate,
    "start() throws away what lay there": _starts_anew,
    "of a silent device it delivers nothing": _is_silent_with_its_device,
    "of noise it delivers nothing": _is_deaf_to_noise,
    "of a third noise it delivers nothing wrong": _invents_nothing("garbage"),
    "of lost lines it delivers nothing wrong": _invents_nothing("loss"),
    "of repeated lines it delivers nothing wrong": _invents_nothing("repeat"),
    "a device that is gone is said at once": _detects_lost_device,
}
"""Sentence -> what looks at it."""
