"""The arithmetic of the end device, integer for integer: layers, γ, proof against overflow.

It defines what `firmware/softsensor/softsensor.h` computes, for every input.
"""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from softcal.core.windows import TAPS

Integers: TypeAlias = NDArray[np.int64]

ACTIVATION_MAX = 32_767
"""Activations and weights stay within ± this: the proof below counts on the symmetric range."""

ACCUMULATOR_MAX = 2**31 - 1
REDUCED_BITS = 16
"""After the first shift an accumulator is within ± 2^16: times 14 bits it stays below 2^31."""

MULTIPLIER_MIN, MULTIPLIER_MAX = 2**13, 2**14 - 1


@dataclass(frozen=True, eq=False)
class IntegerLayer:
    """One layer in integers: 32-bit accumulation, optional ReLU, requantisation, saturation.

    q_out = clip(((acc >> shift1) * multiplier + 2^(shift2 - 1)) >> shift2), acc = bias + Σ weight q_in

    Args:
        weights: (rows, columns) in ± 32767.
        bias: (rows,) in ± (2^31 - 1).
        multiplier: (rows,) in 2^13 ... 2^14 - 1.
        shift1, shift2: (rows,) arithmetic right shifts; shift2 at least 1.

    Raises:
        ValueError: a value is out of range, or some input could overflow the 32-bit accumulator.
    """

    weights: Integers
    bias: Integers
    multiplier: Integers
    shift1: Integers
    shift2: Integers

    def __post_init__(self) -> None:
        check_no_overflow(self)

    @property
    def shape(self) -> tuple[int, int]:
        rows, columns = self.weights.shape
        return rows, columns

    def apply(self, inputs: Integers, is_rectified: bool) -> Integers:
        """Carry (n, columns) activations through the layer: (n, rows)."""
        # NumPy has no fast integer product; the proof keeps sums below 2^53, exact in doubles.
        sums = inputs.astype(np.float64) @ self.weights.T.astype(np.float64)
        accumulator = sums.astype(np.int64) + self.bias
        if is_rectified:
            accumulator = np.maximum(accumulator, 0)
        # Two shifts around a 14-bit multiplier: small cores have no 32 x 32 bit product.
        product = (accumulator >> self.shift1) * self.multiplier
        rounded = (product + (np.int64(1) << (self.shift2 - 1))) >> self.shift2
        clipped: Integers = np.clip(rounded, -ACTIVATION_MAX, ACTIVATION_MAX)
        return clipped


def check_no_overflow(layer: IntegerLayer) -> None:
    """Prove that no input within ± 32767 overflows 32 bits anywhere in the layer.

    Raises:
        ValueError: the row for which the proof fails, with its bound.
    """
    if np.abs(layer.weights).max(initial=0) > ACTIVATION_MAX:
        raise ValueError(f"a weight of {np.abs(layer.weights).max()} is outside ± {ACTIVATION_MAX}")
    # The worst input has every sign against us: the device checks nothing at run time.
    bound = np.abs(layer.weights).sum(axis=1) * ACTIVATION_MAX + np.abs(layer.bias)
    _require(bound <= ACCUMULATOR_MAX, bound, "can reach {} in its accumulator, 2^31 - 1 is the most")
    _require((layer.shift1 >= 0) & (layer.shift1 <= 31), layer.shift1, "shifts by {}, 0 ... 31 is allowed")
    _require((layer.shift2 >= 1) & (layer.shift2 <= 31), layer.shift2, "shifts by {}, 1 ... 31 is allowed")
    is_allowed = (layer.multiplier >= MULTIPLIER_MIN) & (layer.multiplier <= MULTIPLIER_MAX)
    _require(is_allowed, layer.multiplier, "has multiplier {}, 8192 ... 16383 is allowed")
    reduced = (bound >> layer.shift1) + 1  # + 1: an arithmetic shift rounds a negative number away from zero
    product = reduced * layer.multiplier + (np.int64(1) << (layer.shift2 - 1))
    _require(product <= ACCUMULATOR_MAX, product, "can reach {} after its multiplier, 2^31 - 1 is the most")


def _require(holds: NDArray[np.bool_], values: Integers, text: str) -> None:
    bad = np.flatnonzero(~np.broadcast_to(holds, values.shape))
    if len(bad):
        raise ValueError(f"row {bad[0]} " + text.format(values[bad[0]]))


@dataclass(frozen=True, eq=False)
class PiecewiseMap:
    """γ sample by sample: monotone, piecewise linear, constant beyond its end knots.

    Args:
        codes: (k,) input codes, strictly increasing, 0 ... 65535, 2 <= k <= 32.
        values: (k,) source-space counts in ± 32767, monotone.

    Raises:
        ValueError: knots that are not monotone or out of range.
    """

    codes: Integers
    values: Integers

    def __post_init__(self) -> None:
        if not 2 <= len(self.codes) <= MAX_KNOTS or len(self.codes) != len(self.values):
            raise ValueError(f"{len(self.codes)} knots with {len(self.values)} values; 2 ... {MAX_KNOTS} are allowed")
        if np.diff(self.codes).min() <= 0 or self.codes[0] < 0 or self.codes[-1] > CODE_MAX:
            raise ValueError("knot codes must increase strictly within 0 ... 65535")
        if np.abs(self.values).max() > ACTIVATION_MAX:
            raise ValueError(f"a knot value of {np.abs(self.values).max()} is outside ± {ACTIVATION_MAX}")
        steps = np.diff(self.values)
        if steps.min() < 0 < steps.max():
            raise ValueError("knot values rise and fall; the map must be monotone")

    def apply(self, codes: Integers) -> Integers:
        """Carry codes of any shape into source-space counts, halves away from the left knot."""
        inside = np.clip(codes, self.codes[0], self.codes[-1])
        # The last knot begins no segment of its own.
        segment = np.minimum(np.searchsorted(self.codes, inside, side="right") - 1, len(self.codes) - 2)
        span = self.codes[segment + 1] - self.codes[segment]
        rise = self.values[segment + 1] - self.values[segment]
        # Rounded on the size and signed afterwards: falling and rising maps round alike.
        step = (np.abs(rise) * (inside - self.codes[segment]) + span // 2) // span
        mapped: Integers = self.values[segment] + np.sign(rise) * step
        return mapped


MAX_KNOTS = 32
CODE_MAX = 65_535
CODE_CENTRE = 32_768

MAX_SHAPES = 6
KEEP_ONE = 64
"""A mix keeps a share of a window in 1/64, and its sums are in 1/64 count."""

SHAPE_CENTRE, SHAPE_HALF = 7, 8
"""Shapes are polynomials of (tap - 7) / 8; their recurrence takes twice that: a shift by 2."""


@dataclass(frozen=True, eq=False)
class IntegerMix:
    """out = (keep q + Σ_k U_k w_k) / 64 with w_k = (weights_k · q >> shift_k) + bias_k.

    U_k: Chebyshev, second kind, at (tap - 7) / 8, by Clenshaw's recurrence (1955).

    Args:
        keep: 0 ... 255, in 1/64.
        weights: (k, TAPS) in ± 32767; 1 <= k <= 6.
        shift: (k,) arithmetic right shifts, 0 ... 31.
        bias: (k,) in 1/64 counts, ± 2^31.

    Raises:
        ValueError: a value is out of range, or some window could overflow 32 bits.
    """

    keep: int
    weights: Integers
    shift: Integers
    bias: Integers

    def __post_init__(self) -> None:
        count = len(self.bias)
        if not 1 <= count <= MAX_SHAPES or self.weights.shape != (count, TAPS) or not 0 <= self.keep <= 255:
            raise ValueError(f"a mix of {count} shapes with weights {self.weights.shape} that keeps {self.keep}/64")
        largest = np.abs(self.weights).max(axis=1)
        _require(largest <= ACTIVATION_MAX, largest, "has a weight of {}, ± 32767 is allowed")
        _require((self.shift >= 0) & (self.shift <= 31), self.shift, "shifts by {}, 0 ... 31 is allowed")
        total = np.abs(self.weights).sum(axis=1) * ACTIVATION_MAX
        _require(total <= ACCUMULATOR_MAX, total, "can reach {} in its sum, 2^31 - 1 is the most")
        max_terms = (total >> self.shift) + 2 + np.abs(self.bias)
        # |U_k| is at most k + 1; the recurrence multiplies a partial sum by up to 7.
        widest = int(np.sum(max_terms * np.arange(1, count + 1)))
        if SHAPE_CENTRE * widest > ACCUMULATOR_MAX or widest + self.keep * (ACTIVATION_MAX + 1) > ACCUMULATOR_MAX:
            raise ValueError(f"a mix can reach {widest}, which leaves 32 bits")

    def apply(self, counts: Integers) -> Integers:
        steps = (counts @ self.weights.T >> self.shift) + self.bias
        position = np.arange(TAPS, dtype=np.int64) - SHAPE_CENTRE
        total = before = np.zeros(counts.shape, dtype=np.int64)
        for k in reversed(range(len(self.bias))):
            total, before = steps[:, k, None] + (position * total >> 2) - before, total
        mixed: Integers = np.clip((total + self.keep * counts + KEEP_ONE // 2) >> 6, -ACTIVATION_MAX, ACTIVATION_MAX)
        return mixed


@dataclass(frozen=True, eq=False)
class DeviceMap:
    """γ in the form of a device: a curve on every new sample, then a mix of shapes on every window.

    Args:
        curve: maps each code as it comes; without it the code is centred.
        layer: (TAPS, TAPS), never rectified: the linear part of files of up to 1024 bytes.
        mix: the linear part of smaller files; never together with a layer.

    Raises:
        ValueError: none of them is there, both linear parts are, or the layer is not (TAPS, TAPS).
    """

    curve: PiecewiseMap | None
    layer: IntegerLayer | None = None
    mix: IntegerMix | None = None

    def __post_init__(self) -> None:
        if self.curve is None and self.layer is None and self.mix is None:
            raise ValueError("a map needs a curve, a linear part, or both")
        if self.layer is not None and self.mix is not None:
            raise ValueError("a map has one linear part, not a layer and a mix")
        if self.layer is not None and self.layer.shape != (TAPS, TAPS):
            raise ValueError(f"the layer of the map has shape {self.layer.shape}, ({TAPS}, {TAPS}) was expected")

    def on_samples(self, codes: Integers) -> Integers:
        """Return what enters the device's ring for each code."""
        if self.curve is not None:
            return self.curve.apply(codes)
        # Code 0 would be -32768, the one value outside the symmetric range of the proof.
        return np.maximum(codes - CODE_CENTRE, -ACTIVATION_MAX)

    def on_windows(self, ring: Integers) -> Integers:
        """Carry (n, TAPS) windows of the ring into source-space counts."""
        if self.mix is not None:
            return self.mix.apply(ring)
        return ring if self.layer is None else self.layer.apply(ring, is_rectified=False)

    def apply(self, codes: Integers) -> Integers:
        return self.on_windows(self.on_samples(codes))


@dataclass(frozen=True, eq=False)
class IntegerNetwork:
    """The shared network f on source-space counts.

    Args:
        layers: rectified but for the last, which has one row.
        input_zero, input_lsb: source output = input_zero + input_lsb * count.
        output_exponent: an estimate counts 10^output_exponent reference units.

    Raises:
        ValueError: layers that do not fit each other or the window.
    """

    layers: tuple[IntegerLayer, ...]
    input_zero: float
    input_lsb: float
    output_exponent: int

    def __post_init__(self) -> None:
        sizes = self.sizes
        joined = all(a.shape[0] == b.shape[1] for a, b in zip(self.layers[:-1], self.layers[1:], strict=True))
        if sizes[0] != TAPS or sizes[-1] != 1 or not joined:
            raise ValueError(f"sizes {sizes} are no network from {TAPS} samples to one estimate")

    @property
    def sizes(self) -> tuple[int, ...]:
        """Widths from the window to the estimate, for example (15, 120, 70, 35, 1)."""
        return (self.layers[0].shape[1], *(layer.shape[0] for layer in self.layers))

    @property
    def multiplications(self) -> int:
        return sum(layer.weights.size for layer in self.layers)

    def evaluate(self, counts: Integers) -> Integers:
        """Estimate for (n, TAPS) windows of counts: (n,) in 10^output_exponent reference units."""
        activations = counts
        for layer in self.layers[:-1]:
            activations = layer.apply(activations, is_rectified=True)
        return self.layers[-1].apply(activations, is_rectified=False)[:, 0]
