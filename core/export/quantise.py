"""Quantisation of network, map, scales and limits to the integers of the device."""

import math
from dataclasses import dataclass

import numpy as np

from softcal.core.errors import UnitRefused
from softcal.core.export import integer_network as integer
from softcal.core.export.blob import MAX_BANDS
from softcal.core.export.compile_map import InputScale, Linear, MapForm
from softcal.core.export.integer_network import ACTIVATION_MAX, CODE_MAX
from softcal.core.network.network import Network
from softcal.core.recording import Array
from softcal.core.windows import TAPS, resting

HEADROOM = 1.5
"""Ranges seen on the source's windows are widened by this: of activations before they are cut into
counts, of the estimate before it saturates."""

STRETCH, SHIFT = 1.3, 0.1
"""Other units' mapped windows may be this much larger, or moved by this share of the span."""

QUIET = 4
"""No hidden unit gets less than this fraction of its layer's widest range."""


def quantise_network(network: Network, source_windows: Array) -> integer.IntegerNetwork:
    """Return the integer form of f; the activation ranges come from the source's windows.

    Args:
        source_windows: (n, TAPS) windows of the source recording in `network.output_unit`.

    Raises:
        UnitRefused: a row for which no scale keeps the 32-bit accumulator from overflowing.
    """
    max_swing = HEADROOM * float(np.abs(source_windows - network.output_mean).max())
    input_lsb = _scale_of(np.array([max_swing]))[0]
    top = HEADROOM * float(np.abs(evaluate_float64(network, source_windows)).max())
    if not (np.isfinite(top) and top > 0):
        raise UnitRefused(f"the network answers {top} on every window of the source; there is nothing to export")
    exponent = max(-30, math.ceil(math.log10(top / ACTIVATION_MAX)))
    centre, span = float(source_windows.mean()), float(np.ptp(source_windows))
    stretched = centre + STRETCH * (source_windows - centre)
    shifted = [source_windows + SHIFT * span, source_windows - SHIFT * span]
    # As other units may send them: stretched, shifted, reversed in time, flattened.
    relatives = np.concatenate(
        [source_windows, stretched, *shifted, source_windows[:, ::-1], resting(source_windows[:, -1])]
    )
    ranges = [HEADROOM * a.max(axis=0) for a in activations(network, relatives)[:-1]]
    # Real value of one count where it enters and leaves each layer; every hidden unit has its own.
    scales = [np.full(network.sizes[0], input_lsb), *map(_scale_of, ranges), np.array([10.0**exponent])]
    layers = tuple(
        quantise_layer(weight.T, bias, scales[i], scales[i + 1]) for i, (weight, bias) in enumerate(network.folded)
    )
    return integer.IntegerNetwork(layers, network.output_mean, float(input_lsb), exponent)


def activations(network: Network, windows: Array) -> list[Array]:
    """Return what leaves each layer in float64, the estimate (n, 1) last."""
    hidden, layers = windows - network.output_mean, []
    for weight, bias in network.folded[:-1]:
        hidden = np.maximum(hidden @ weight + bias, 0.0)
        layers.append(hidden)
    weight, bias = network.folded[-1]
    return [*layers, hidden @ weight + bias]


def evaluate_float64(network: Network, windows: Array) -> Array:
    """Estimate in float64: (n,) in `network.reference_unit`."""
    return activations(network, windows)[-1][:, 0]


def _scale_of(ranges: Array) -> Array:
    """Real value of one count, so that `ranges`, or the widest over `QUIET`, is the largest."""
    widest = float(ranges.max()) or 1.0
    return np.maximum(ranges, widest / QUIET) / ACTIVATION_MAX


def quantise_layer(weights: Array, bias: Array, scale_in: Array, scale_out: Array) -> integer.IntegerLayer:
    """Cut one layer into integers, each row with the finest weight step the overflow proof allows.

    Args:
        weights: (rows, columns) real weights.
        bias: (rows,) real biases.
        scale_in: (columns,) real value of one count of each input.
        scale_out: (rows,) real value of one count of each output.

    Raises:
        UnitRefused: a row for which there is no such step.
    """
    per_count = weights * scale_in
    rows = [_quantise_row(w, float(b), float(s)) for w, b, s in zip(per_count, bias, scale_out, strict=True)]
    try:
        return integer.IntegerLayer(*(np.array(column, dtype=np.int64) for column in zip(*rows, strict=True)))
    except ValueError as error:
        raise UnitRefused(f"no integer form without overflow: {error}; train the network again") from error


def _quantise_row(weights: Array, bias: float, scale_out: float) -> tuple[list[int], int, int, int, int]:
    """Return weights, bias, multiplier, shifts of a row; `weights` in real units per count."""
    largest = float(np.abs(weights).max(initial=0.0))
    # Rounding may add half a step a weight; the bias rounds the first shift.
    # The finest step that can still not overflow: steps are chosen by the proof, not by trial.
    budget = integer.ACCUMULATOR_MAX - len(weights) * ACTIVATION_MAX - 2**16
    max_sum = float(np.abs(weights).sum()) * ACTIVATION_MAX + abs(bias)
    if max_sum == 0.0:
        return [0] * len(weights), 0, integer.MULTIPLIER_MIN, 0, 14
    # Either the largest weight or the sum of all of them sets the step.
    step = max(largest / ACTIVATION_MAX, max_sum / budget)
    integers = [round(float(w) / step) for w in weights]
    integer_bias = round(bias / step)
    bound = sum(map(abs, integers)) * ACTIVATION_MAX + abs(integer_bias) + 2**15
    shift1 = max(0, bound.bit_length() - integer.REDUCED_BITS)
    multiplier, shift2 = _as_multiplier(step / scale_out * 2.0**shift1)
    half = 2 ** (shift1 - 1) if shift1 else 0  # turns the floor of the first shift into rounding
    return integers, integer_bias + half, multiplier, shift1, shift2


def _as_multiplier(factor: float) -> tuple[int, int]:
    """Return (multiplier, shift) with factor = multiplier / 2^shift and a 14-bit multiplier."""
    mantissa, exponent = math.frexp(factor)  # factor = mantissa * 2^exponent, mantissa in [0.5, 1)
    multiplier, shift = round(mantissa * 2**14), 14 - exponent
    if multiplier > integer.MULTIPLIER_MAX:
        multiplier, shift = integer.MULTIPLIER_MIN, shift - 1
    if shift > 31:  # a row too weak to move one count: no shift of 32 bits can say so but zero
        return integer.MULTIPLIER_MIN, 31
    return multiplier, shift


def quantise_map(form: MapForm, scale: InputScale, network: integer.IntegerNetwork) -> integer.DeviceMap:
    """Cut a compiled map into integers between the unit's codes and the network's counts.

    Raises:
        UnitRefused: knots that fall together, or a map that needs more than 16 bits.
    """
    if form.curve is None:
        raise UnitRefused("a device takes a curve, alone or with a linear part")
    try:
        # Cut where it leaves the network's counts: clipped knots would bend what lies between.
        outputs, values = form.curve.outputs, form.curve.values
        low, high = (network.input_zero + side * network.input_lsb * ACTIVATION_MAX for side in (-1, 1))
        # Interpolated from value to output, in rising order: a falling sensor has them reversed.
        order = np.argsort(values, kind="stable")
        bounds = [b for b in (low, high) if values.min() < b < values.max()]
        crossings = np.interp(bounds, values[order], outputs[order])
        inside = np.abs(values - network.input_zero) <= network.input_lsb * ACTIVATION_MAX
        outputs_in_range = np.unique(np.concatenate([outputs[inside], crossings]))
        # Knots closer than one code fall together; one of them is kept.
        codes, first = np.unique(scale.codes(outputs_in_range), return_index=True)
        counts = np.rint((form.curve.apply(outputs_in_range)[first] - network.input_zero) / network.input_lsb)
        stored = np.clip(counts, -ACTIVATION_MAX, ACTIVATION_MAX).astype(np.int64)
        curve = integer.PiecewiseMap(codes, stored)
        if isinstance(form.linear, Linear):
            # Counts in, counts out: count = (output - zero) / lsb on both sides.
            matrix, zero, one = form.linear.matrix, network.input_zero, np.full(TAPS, network.input_lsb)
            bias = zero * matrix.sum(axis=1) + form.linear.offset - zero
            return integer.DeviceMap(curve, quantise_layer(matrix, bias, one, one))
        mix = None if form.linear is None else form.linear.in_counts(network.input_zero, network.input_lsb)
        return integer.DeviceMap(curve, None, mix)
    except ValueError as error:
        raise UnitRefused(f"the map has no integer form: {error}") from error


def code_range(scale: InputScale, output: Array) -> tuple[int, int]:
    """Return the range of codes of a unit's recording, widened by 2 % of its span for noise."""
    codes = scale.codes(output)
    margin = math.ceil(0.02 * float(codes.max() - codes.min()))
    return max(0, int(codes.min()) - margin), min(CODE_MAX, int(codes.max()) + margin)


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of the estimates of one unit in its device file, in physical units.

    Args:
        output_low, output_high: sensor output the unit was calibrated with, in the output unit.
        estimate_low, estimate_high: the estimate is clamped to these, in reference units.
        levels: (b - 1,) estimates at which the next band begins, rising.
        minus, plus: (b,) reach of the 90 % interval below and above the estimate, by band.
    """

    output_low: float  # noqa: V107
    output_high: float  # noqa: V107
    estimate_low: float  # noqa: V107
    estimate_high: float  # noqa: V107
    levels: Array
    minus: Array
    plus: Array


def half_width_by_band(estimate: Array | integer.Integers, below: Array, above: Array) -> tuple[Array, Array, Array]:
    """Return levels between `MAX_BANDS` bands of an estimate, and its mean reach in each.

    Args:
        estimate, below, above: (m,), in any unit; an empty band has the reach of all.
    """
    levels = np.linspace(estimate.min(), estimate.max(), MAX_BANDS + 1)[1:-1]
    band = np.searchsorted(levels, estimate, side="left")
    rows_by_band = [band == k if (band == k).any() else np.ones(len(estimate), dtype=bool) for k in range(MAX_BANDS)]
    minus, plus = (np.array([np.mean(half_width[rows]) for rows in rows_by_band]) for half_width in (below, above))
    return levels, minus, plus
