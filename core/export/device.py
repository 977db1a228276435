"""A calibrated unit and its shared network as device files, and what that costs in accuracy."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from softcal.core.errors import UnitRefused
from softcal.core.export import blob, quantise
from softcal.core.export.blob import NetworkFile, SelfTest, UnitFile
from softcal.core.export.blob_reader import read_unit
from softcal.core.export.compile_map import SIZED_FORMS, CompiledMap, Forms, InputScale, compile_map
from softcal.core.export.integer_network import ACTIVATION_MAX, CODE_MAX, DeviceMap, IntegerNetwork, Integers
from softcal.core.export.loader import join, run_self_test
from softcal.core.maps.anchors import SourceLevels
from softcal.core.maps.config import AnchorConfig
from softcal.core.maps.interface import UnitMap
from softcal.core.network.network import Network
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.windows import TAPS

FORMS_OF: Mapping[int, Forms] = dict(zip(blob.UNIT_BYTES, SIZED_FORMS, strict=True))
"""Forms of a map by the largest size of its file."""

GOAL = 1e-3
"""A device should stay this close to f∘γ, as a share of the span of the unit's estimates."""

VERDICT_FLAGS = {"pass": 0, "conditional": blob.CONDITIONAL, "fail": blob.FAILED, "retest": blob.FAILED}
REST_QUANTILE = 1 / 32
"""Quantile of the mapped samples that stands for a unit's rest."""

COVERED = 0.95
"""The interval on the device is widened by this quantile of what the device form changes."""


@dataclass(frozen=True)
class DeviceOptions:
    """Choices of one export.

    Args:
        scale: meaning of the device's codes; None covers the unit's output with a round full scale.
        compile_limit: largest rms change of the estimate, as a share of the forecast.
        unit_bytes: the most a unit file may take; None: the least that holds `GOAL`.
    """

    scale: InputScale | None = None
    compile_limit: float = 0.25
    unit_bytes: int | None = None


@dataclass(frozen=True, eq=False)
class DeviceRecord:
    """Data of one calibrated unit that an export uses.

    Args:
        time_s: when it was made, Unix time in s.
        lower, upper: (m,) the 90 % interval of f∘γ at every window, in reference units.
        predicted_rmse: forecast of the error in reference units, or None.
    """

    serial: str
    revision: int
    verdict: str
    time_s: int
    unit_map: UnitMap
    recording: OutputRecording
    lower: Array
    upper: Array
    predicted_rmse: float | None


@dataclass(frozen=True, eq=False)
class DeviceUnit:
    """A unit file with its size and errors, in reference units on the unit's own windows.

    Args:
        compiled: the form of γ in floating point and its deviation.
        rms_error, max_error: of the integers on the device against f∘γ in float64.
        limit: what `rms_error` was allowed to be.
        goal: what `max_error` should stay below.
    """

    file: UnitFile
    compiled: CompiledMap
    rms_error: float
    max_error: float
    limit: float
    goal: float


def build_network_file(network: Network, source: LabelledRecording, anchors: AnchorConfig) -> NetworkFile:
    """Make the shared file of a lot from f and its source: the same input, the same bytes.

    Raises:
        UnitRefused: f is too large for the format, or has no integer form without overflow.
    """
    if max(network.sizes) > blob.MAX_WIDTH or len(network.weights) > blob.MAX_LAYERS:
        raise UnitRefused(
            f"network {'-'.join(map(str, network.sizes))} is too large for a device file: {blob.MAX_LAYERS} layers of "
            f"{blob.MAX_WIDTH} are the most; train a smaller one or fewer members"
        )
    integers = quantise.quantise_network(network, source.windows)
    stored = replace(integers, input_zero=_float32(integers.input_zero), input_lsb=_float32(integers.input_lsb))
    levels = SourceLevels.from_source(source, anchors)
    count = 10.0**stored.output_exponent
    first, last = (round(float(load) / count) for load in levels.load[[0, -1]])
    step = max(1, (last - first) // (len(levels.load) - 1))
    loads = np.asarray((first + step * np.arange(len(levels.load))) * count, np.float64)
    counts = np.rint((levels.at(loads) - stored.input_zero) / stored.input_lsb)
    clipped = np.clip(counts, -ACTIVATION_MAX, ACTIVATION_MAX).astype(np.int64).tolist()
    return NetworkFile(
        stored,
        network.id,
        source.serial,
        sample_period_us(source),
        network.output_unit,
        network.reference_unit,
        blob.LoadLevels(max(-ACTIVATION_MAX, first), step, tuple(clipped)),
    )


def sample_period_us(source: LabelledRecording) -> int:
    """Return the time between two samples of the source's recording in µs."""
    return round(1e6 / source.unlabelled.sample_rate_Hz)


def limits_of_unit(record: DeviceRecord, network: Network, options: DeviceOptions) -> quantise.Limits:
    """Return interval, range (of its codes) and clamp of a unit in floating point."""
    exact = network.evaluate(record.unit_map.apply(record.recording.windows))
    scale = _scale(options, network, record)
    code_min, code_max = quantise.code_range(scale, record.recording.output)
    low, high, margin = float(exact.min()), float(exact.max()), float(np.ptp(exact)) / 4
    return quantise.Limits(
        scale.zero + scale.lsb * (code_min - 0.5),
        scale.zero + scale.lsb * (code_max + 0.5),
        low - margin,
        high + margin,
        *quantise.half_width_by_band(exact, exact - record.lower, record.upper - exact),
    )


def build_unit_file(
    record: DeviceRecord,
    network: Network,
    network_file: NetworkFile,
    options: DeviceOptions = DeviceOptions(),  # noqa: B008
) -> DeviceUnit:
    """Compile γ to integers, measure the errors on the recording, and read the file back.

    Without a size the smallest file within `GOAL` is taken, else the nearest one.

    Raises:
        UnitRefused: no device form, or no integers, within the limit.
    """
    sizes = blob.UNIT_BYTES if options.unit_bytes is None else (options.unit_bytes,)
    best, refusal = None, None
    for size in sizes:
        try:
            unit = _build(record, network, network_file, options, size)
        except UnitRefused as error:
            refusal = error
            continue
        if best is None or unit.max_error < best.max_error:
            best = unit
        if best.max_error <= best.goal:
            break
    if best is None:
        raise refusal or UnitRefused(f"unit {record.serial} has no device form")
    return best


def _build(
    record: DeviceRecord, network: Network, network_file: NetworkFile, options: DeviceOptions, size: int
) -> DeviceUnit:
    windows = record.recording.windows
    exact = quantise.evaluate_float64(network, record.unit_map.apply(windows))
    limit, goal = device_limit(record, network, options), GOAL * float(np.ptp(exact))
    scale = _scale(options, network, record)
    _check_scale(scale, record)
    compiled = compile_map(record.unit_map, network, record.recording, limit, FORMS_OF[size], goal / 2)
    integers = network_file.network
    device_map = quantise.quantise_map(compiled.form, scale, integers)
    codes = scale.codes(windows)
    counts = integers.evaluate(device_map.apply(codes))
    error = counts * 10.0**integers.output_exponent - exact
    rms_error, max_error = float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())
    if rms_error > limit:
        raise UnitRefused(
            f"unit {record.serial}: the integers of the device are {rms_error:.3g} {network.reference_unit} rms off, "
            f"{limit:.3g} is allowed; give the converter's own scale, or calibrate with another map"
        )
    code_min, code_max = quantise.code_range(scale, record.recording.output)
    # Estimates seen on the unit's recording, and a quarter of their span beyond on both sides.
    margin = int(np.ptp(counts)) // 4 + 1
    file = UnitFile(
        serial=record.serial,
        network_id=network_file.id,
        revision=record.revision,
        time_s=record.time_s,
        flags=VERDICT_FLAGS[record.verdict],
        device_map=device_map,
        scale=scale,
        code_min=code_min,
        code_max=code_max,
        out_min=max(-ACTIVATION_MAX, int(counts.min()) - margin),
        out_max=min(ACTIVATION_MAX, int(counts.max()) + margin),
        bands=_bands(counts, exact, record, error, 10.0**integers.output_exponent),
        self_tests=_self_tests(integers, device_map, code_min, code_max),
        pivot=_pivot(device_map, codes),
    )
    if (needed := len(file.to_bytes())) > size:
        raise UnitRefused(f"unit {file.serial}: its file would take {needed} bytes, {size} is allowed")
    join(network_file, read_unit(file.to_bytes()), record.serial)
    return DeviceUnit(file, compiled, rms_error, max_error, limit, goal)


def device_limit(record: DeviceRecord, network: Network, options: DeviceOptions) -> float:
    """Return the largest rms change of the estimate a compiled form may make, in reference units.

    A quarter of the predicted error raises the error by 3 % at most, as both add in quadrature.
    Without a forecast it is 1 % of the span of the estimates.
    """
    if record.predicted_rmse:
        return options.compile_limit * record.predicted_rmse
    return 0.01 * float(np.ptp(network.evaluate(record.unit_map.apply(record.recording.windows))))


def _scale(options: DeviceOptions, network: Network, record: DeviceRecord) -> InputScale:
    """Return the scale in the precision of a file, so that its reader computes the same codes."""
    scale = options.scale or InputScale.cover_range(network, record.recording.output)
    return InputScale(_float32(scale.zero), _float32(scale.lsb))


def _float32(value: float) -> float:
    return float(np.float32(value))


def _check_scale(scale: InputScale, record: DeviceRecord) -> None:
    low, high = float(record.recording.output.min()), float(record.recording.output.max())
    top = scale.zero + scale.lsb * (CODE_MAX + 0.5)
    if low < scale.zero - scale.lsb or high > top:
        raise UnitRefused(
            f"unit {record.serial} puts out {low:.6g} ... {high:.6g} {record.recording.output_unit}, the converter "
            f"takes {scale.zero:.6g} ... {top:.6g}; correct its full scale"
        )


def _bands(counts: Integers, exact: Array, record: DeviceRecord, error: Array, count: float) -> tuple[blob.Band, ...]:
    """Return the 90 % interval by level: per band its mean half-width and the device's own error."""
    device_error = float(np.quantile(np.abs(error), COVERED))
    levels, *half_widths = quantise.half_width_by_band(counts, exact - record.lower, record.upper - exact)
    minus, plus = (
        np.clip(np.ceil((side + device_error) / count), 0, CODE_MAX).astype(int).tolist() for side in half_widths
    )
    return tuple(map(blob.Band, (*map(int, levels), ACTIVATION_MAX), minus, plus))


def _self_tests(network: IntegerNetwork, device_map: DeviceMap, code_min: int, code_max: int) -> tuple[SelfTest, ...]:
    """Return self-tests: at rest, at the top, rising and falling through the unit's whole range."""
    step = (code_max - code_min) // (TAPS - 1)
    windows = [(code_min, 0), (code_max, 0), (code_min, step), (code_min + step * (TAPS - 1), -step)]
    return tuple(
        SelfTest(start, rise, run_self_test(network, device_map, SelfTest(start, rise, 0))) for start, rise in windows
    )


def _pivot(device_map: DeviceMap, codes: Integers) -> int:
    """Return the level of mapped samples that a trim turns about."""
    if device_map.curve is None:
        return 0
    return round(float(np.quantile(device_map.on_samples(codes[:, -1]), REST_QUANTILE)))


STATE_BYTES, BYTES_PER_WIDTH, MIN_WIDTH = 100, 4, 16
"""Of `ss_sensor` on 32 bits: its fixed part, and two buffers as wide as the widest layer."""

PER_MULTIPLICATION, PER_ROW, ALWAYS, PER_MIX = 4.0, 45.0, 570.0, 2500.0
"""Instructions of a Cortex-M0, fitted to counts in QEMU at -Os (benchmarks/export_device.py)."""

CYCLES_PER_INSTRUCTION, CLOCK_kHz = 1.36, 48_000.0
"""Of a Cortex-M0+ with one flash wait state, from a cycle model; right to about 10 %."""


@dataclass(frozen=True)
class DeviceCost:
    """Cost of one estimate on a Cortex-M0+ at 48 MHz.

    Args:
        ram_bytes: of `ss_sensor`; the stack comes on top.
        instructions: of one new sample and its estimate.
        estimate_ms: the same in time.
    """

    ram_bytes: int
    instructions: int
    estimate_ms: float


def device_cost(network: IntegerNetwork, device_map: DeviceMap) -> DeviceCost:
    """Return the cost of a sample and its estimate."""
    padded = [rows + -rows % 4 for rows in network.sizes[1:]]
    multiplications = sum(columns * rows for columns, rows in zip(network.sizes[:-1], padded, strict=True))
    instructions = PER_MULTIPLICATION * multiplications + PER_ROW * sum(padded) + ALWAYS
    instructions += PER_MIX * (device_map.mix is not None)
    return DeviceCost(
        STATE_BYTES + BYTES_PER_WIDTH * max(MIN_WIDTH, *padded),
        round(instructions),
        instructions * CYCLES_PER_INSTRUCTION / CLOCK_kHz,
    )
