"""Recording of a finished run: channels on the sensor's clock, with their alignment."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from softcal.core.errors import BadReply, InputError
from softcal.core.messages.reason import Reason, reason
from softcal.core.recording import Array, Indices, LabelledRecording, OutputRecording
from softcal.station.clock import CLOCK_SHARE, ClockFit, fit_clock, residual_offset_s
from softcal.station.device_names import CELL, device_label
from softcal.station.interfaces import Sample, StagePosition
from softcal.station.record.method import METHOD, ProofMethod
from softcal.station.record.proof import (
    PressLaw,
    check_converter,
    check_follows,
    check_gain,
    check_output_gain,
    check_strokes,
)
from softcal.station.record.response import (
    CellResponse,
    check_explained,
    check_lag,
    check_response,
    fit_response,
)
from softcal.station.record.spool import SpooledRun
from softcal.station.trajectory import DrivenMove, StageTrack, Trapezoid, reconstruct_track

LARGEST_LOSS = 0.02
"""A recording that lost more of its samples than this is not one."""

LONGEST_GAP_S = 0.25
"""Force is read between two samples of the load cell no further apart than this: one of a cell at 10 Hz may be lost."""

FIT_SAMPLES = 3000
"""Enough of a run for a fit of force and depth: how late the cell is, whether one law holds."""


@dataclass(frozen=True)
class Alignment:
    """Alignment of the channels to one time axis.

    Args:
        sensor_drift, force_drift: rate of the device clocks against the host's, minus 1.
        sensor_late_s, force_late_s: median delay of a line behind its earliest possible arrival.
        force_offset_s, stage_offset_s: how much later the output shows what force and stage show, from their rates of
            change. Not applied, since the sensor's own lag is in it. NaN where there is no such channel.
        stage_residual_mm: root mean square of status polls against the reconstructed path.
        force_behind_s: how far the load cell was found behind the stage.
        force_time_constant_s: of the first-order low pass behind which the load cell was found; 0 for none.
        force_response_N: RMS error of the labels that it leaves.
    """

    sensor_drift: float
    force_drift: float  # noqa: V107
    sensor_late_s: float  # noqa: V107
    force_late_s: float
    force_offset_s: float  # noqa: V107
    stage_offset_s: float
    stage_residual_mm: float  # noqa: V107
    force_behind_s: float = float("nan")
    force_time_constant_s: float = 0.0
    force_response_N: float = 0.0


@dataclass(frozen=True, eq=False)
class StationRecording:
    """Recording of one finished run of one unit.

    Args:
        serial: of the unit; with several channels each has a serial, and `serial` names the substrate.
        t_s: (n,) the sensor's own clock, s since the first sample of the profile.
        output: (n, channels) in `output_unit`.
        stage_mm: (n,) position, 0 at the start of the profile, positive when it compresses.
        force_N: (n,) force with zero subtracted; None for a unit without reference.
        contact_mm: where contact was found, from the homing switch.
        zero_N, zero_return_N: the unloaded load cell before the run, and its change over the run.
        remarks: what a person should know of it although it is good.
        proof_method: identity of the method that proved it.
    """

    serial: str
    profile: str
    t_s: Array
    output: Array
    stage_mm: Array
    force_N: Array | None
    sample_rate_Hz: float
    output_unit: str
    contact_mm: float
    zero_N: float
    zero_return_N: float
    lost: int
    alignment: Alignment
    remarks: tuple[Reason, ...] = ()
    proof_method: str | None = None

    def output_recording(self, channel: int = 0, serial: str | None = None) -> OutputRecording:
        return OutputRecording(
            serial or self.serial,
            self.t_s,
            self.output[:, channel],
            self.sample_rate_Hz,
            self.output_unit,
            self.stage_mm,
        )

    def labelled_recording(self) -> LabelledRecording:
        """Return the first channel with the force as reference; raise `ValueError` without a force."""
        if self.force_N is None:
            raise ValueError(f"{self.serial}: recorded without a reference")
        return LabelledRecording(self.output_recording(), self.force_N, "N")


@dataclass(frozen=True)
class RunMetadata:
    """Metadata of a run that a text file can store.

    Args:
        moves: (start_mm, end_mm, speed_mm_s, acceleration_mm_s2, begun_s, confirmed_s) of every move.
        span_s: host time at which the profile began and ended.
        zero_mm: stage position that is 0 in the recording.
        contact_mm, zero_N, zero_return_N: as in `StationRecording`.
        with_reference: whether the recording keeps the force.
        force_late_s: latency of the load cell as used in the run; subtracted from its times.
        is_latency_declared: whether the station file states the latency; otherwise the measured latency is subtracted.
    """

    serial: str
    profile: str
    sensor: str
    output_unit: str
    sample_rate_Hz: float
    moves: Sequence[tuple[float, float, float, float, float, float]]
    span_s: tuple[float, float]
    zero_mm: float
    contact_mm: float
    zero_N: float
    zero_return_N: float
    with_reference: bool
    force_late_s: float = 0.0
    is_latency_declared: bool = True


@dataclass(frozen=True)
class Raw:
    """All readings of a run, in order of arrival; no force without a load cell."""

    output: Sequence[Sample]
    force: Sequence[Sample]
    polls: Sequence[StagePosition]


def assemble(raw: Raw, metadata: RunMetadata, method: ProofMethod = METHOD) -> StationRecording:
    """Interpolate all channels to the sensor's clock and cut the profile out of the run.

    Raises:
        BadReply: too many samples were lost, a device clock is far off, or the load cell does not tell the stage's
            story (late, behind a low pass, another gain from press to press).
    """
    sensor, begun_s, ended_s = _channel(raw.output, metadata.sensor), *metadata.span_s
    chosen = (sensor.host_s >= begun_s) & (sensor.host_s <= ended_s)
    sensor_s, host_s, output = sensor.device_s[chosen], sensor.host_s[chosen], sensor.values[chosen]
    lost = _count_lost_samples(sensor_s, metadata)
    track = track_of(raw, metadata)
    stage_mm = track.at(host_s) - metadata.zero_mm
    check_converter(sensor_s - sensor_s[0], output, stage_mm, metadata.output_unit, method)
    depth_mm = np.maximum(0.0, track.at(host_s) - metadata.contact_mm)
    check_strokes(sensor_s, output, depth_mm, metadata.sensor, method.stroke)
    follows: BadReply | None = None
    try:
        check_follows(host_s, output, track.at, metadata.contact_mm, method)
    except BadReply as error:
        follows = error  # A cell may know why.
        if not raw.force:
            raise
    force_N, (behind_s, offset_s, cell_drift, cell_late_s) = None, (float("nan"),) * 4
    constant_s, response_N, remarks = 0.0, 0.0, tuple[Reason, ...]()
    if not raw.force:
        check_output_gain(stage_mm, output[:, 0], method.press)
    else:
        cell = _channel(raw.force, CELL)
        if follows is not None:
            raise _law(cell, sensor, track, metadata, metadata.force_late_s, method).name_cause(follows) from follows
        response, late_s = _response(cell, track, metadata, method), metadata.force_late_s
        constant_s, behind_s = response.time_constant_s, response.lag_s
        if not metadata.is_latency_declared and abs(behind_s - late_s) > method.lag.late_s:
            late_s = behind_s
        response_N = response.error_N(late_s)
        if metadata.with_reference:
            check_response(response, response_N, method.response)
        if metadata.is_latency_declared:
            check_lag(response, metadata.force_late_s, float(np.median(np.diff(cell.device_s))), method.lag)
        remarks = _check_cell(cell, sensor, track, metadata, late_s, method)
        if metadata.with_reference:
            check_explained(response, method.response)
        force_N = _force_at(host_s, cell, metadata, late_s)
        check_strokes(sensor_s, force_N[:, None], depth_mm, CELL, method.stroke)
        offset_s = residual_offset_s(force_N, output[:, 0], metadata.sample_rate_Hz)
        cell_drift, cell_late_s = cell.clock.rate - 1, cell.clock.late_s
    stage_offset_s = residual_offset_s(np.maximum(stage_mm, 0.0), output[:, 0], metadata.sample_rate_Hz)
    late, offsets = (sensor.clock.late_s, cell_late_s), (offset_s, stage_offset_s)
    return StationRecording(
        metadata.serial,
        metadata.profile,
        sensor_s - sensor_s[0],
        output,
        stage_mm,
        force_N if metadata.with_reference else None,
        metadata.sample_rate_Hz,
        metadata.output_unit,
        metadata.contact_mm,
        metadata.zero_N,
        metadata.zero_return_N,
        lost,
        Alignment(
            sensor.clock.rate - 1, cell_drift, *late, *offsets, track.residual_mm, behind_s, constant_s, response_N
        ),
        remarks,
        method.id,
    )


def track_of(raw: Raw, metadata: RunMetadata) -> StageTrack:
    """Return where the stage was from the first move of a run on."""
    moves = [DrivenMove(Trapezoid(*row[:4]), *row[4:]) for row in metadata.moves]
    return reconstruct_track([poll for poll in raw.polls if poll.host_s >= moves[0].begun_s], moves)


def restore(run: SpooledRun, method: ProofMethod = METHOD) -> StationRecording:
    """Make the recording of a finished run again from its spool.

    Raises:
        InputError: the run was aborted or cut off; it is not a recording and never becomes one. Or its facts are not
            those of its samples: another version of softcal wrote them.
        BadReply: as `assemble`.
    """
    serial = run.header.get("serial", "?")
    if not run.is_complete or not run.metadata:
        raise InputError(reason("rig.run_ended", serial=serial, end=run.end))
    try:
        return assemble(Raw(run.output, run.force, run.polls), RunMetadata(**run.metadata), method)
    except (IndexError, TypeError, ValueError) as error:
        raise InputError(reason("rig.run_facts", serial=serial)) from error


def clock_of(samples: Sequence[Sample]) -> tuple[Array, ClockFit]:
    """Return (n,) times by the device's clock, or the host's if it has none, and the fit to the host's clock."""
    device_s = np.array([sample.host_s if sample.device_s is None else sample.device_s for sample in samples])
    if samples[0].device_s is None:
        return device_s, ClockFit(0.0, 1.0, 0.0, 0.0)
    return device_s, fit_clock(device_s, np.array([sample.host_s for sample in samples]))


def device_times_s(samples: Sequence[Sample]) -> Array:
    """Return (n,) sampling times by the host clock, through the device's clock if it has one."""
    device_s, clock = clock_of(samples)
    return clock.to_host(device_s)


@dataclass(frozen=True, eq=False)
class _Channel:
    """(n,) times by the device's and the host's clock, (n, channels) values, the fit of the clock."""

    device_s: Array
    host_s: Array
    values: Array
    clock: ClockFit


def _channel(samples: Sequence[Sample], name: str) -> _Channel:
    device_s, clock = clock_of(samples)
    if abs(clock.rate - 1) > CLOCK_SHARE:
        raise BadReply(reason("rig.clock", device=device_label(name), percent=100 * (clock.rate - 1)))
    return _Channel(device_s, clock.to_host(device_s), np.array([sample.values for sample in samples]), clock)


def _count_lost_samples(sensor_s: Array, metadata: RunMetadata) -> int:
    expected = round((sensor_s[-1] - sensor_s[0]) * metadata.sample_rate_Hz) + 1
    lost = max(0, int(expected) - len(sensor_s))
    if lost > LARGEST_LOSS * expected:
        raise BadReply(reason("rig.lost", device=device_label(metadata.sensor), lost=lost, count=expected))
    return lost


def _response(cell: _Channel, track: StageTrack, metadata: RunMetadata, method: ProofMethod) -> CellResponse:
    # The slow press before the profile counts, too: one speed cannot tell a delay from a loop of the unit's.
    inside = _enough(_in_presses(cell.host_s, metadata))
    return fit_response(cell.host_s[inside], cell.values[inside, 0], track.at, metadata.contact_mm, method)


def _in_presses(force_s: Array, metadata: RunMetadata) -> Indices:
    return np.flatnonzero((force_s >= metadata.moves[0][4]) & (force_s <= metadata.span_s[1]))


def _enough(samples: Indices) -> Indices:
    """Return every so many of them that a fit stays fast."""
    return samples[:: max(1, len(samples) // FIT_SAMPLES)]


def _check_cell(
    cell: _Channel, sensor: _Channel, track: StageTrack, metadata: RunMetadata, late_s: float, method: ProofMethod
) -> tuple[Reason, ...]:
    """Compare all presses including the slow one, as a gain may change between them; return the remarks."""
    force_s, force_N = cell.host_s - late_s, cell.values[:, 0] - metadata.zero_N
    inside = _in_presses(force_s, metadata)
    if not len(inside):
        return ()
    law = _law(cell, sensor, track, metadata, late_s, method)
    law.check_slip()
    try:
        check_gain(track.at(force_s[inside]) - metadata.zero_mm, force_N[inside], method.press)
        law.check()
    except BadReply as error:
        raise law.name_cause(error) from error
    change = law.find_output_change()
    return () if change is None else (change,)


def _law(
    cell: _Channel, sensor: _Channel, track: StageTrack, metadata: RunMetadata, late_s: float, method: ProofMethod
) -> PressLaw:
    """Return the laws of some samples of the cell in the presses, its lateness taken off."""
    force_s = cell.host_s - late_s
    inside = _enough(_in_presses(force_s, metadata))
    output = np.interp(force_s[inside], sensor.host_s, sensor.values[:, 0])
    force_N = cell.values[inside, 0] - metadata.zero_N
    return PressLaw(force_s[inside], force_N, output, track.at, metadata.contact_mm, method)


def _force_at(host_s: Array, cell: _Channel, metadata: RunMetadata, late_s: float) -> Array:
    """Return the force at host times, zero subtracted, of a load cell that is late by so much."""
    force_s = cell.host_s - late_s
    # One sample beyond either end is needed, too; what lies before it is homing and the search for contact.
    first, last = np.searchsorted(force_s, (host_s[0], host_s[-1]))
    longest_s = float(np.max(np.diff(force_s[max(0, first - 1) : last + 1]), initial=0.0))
    if longest_s > LONGEST_GAP_S:
        raise BadReply(reason("rig.gap", seconds=longest_s))
    return np.interp(host_s, force_s, cell.values[:, 0]) - metadata.zero_N
