"""The shared network f as plain arrays, and its evaluation without torch."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softcal.core.identity import content_sha256
from softcal.core.recording import Array

CHUNK = 2_048
"""Windows per matrix product: the activations stay in cache."""

_SCALES = ("output_mean", "output_scale", "reference_mean", "reference_scale")
_UNITS = ("output_unit", "reference_unit")
"""Fields as a network is kept."""


@dataclass(frozen=True, eq=False)
class Network:
    """A time-delay network with ReLU between its layers (Kim et al. 2020, Experimental Section).

    f(x) = reference_mean + reference_scale * W_L relu(... relu(W_1 (x - output_mean) / output_scale + b_1) ...) + b_L

    Args:
        weights: per layer (inputs, outputs).
        biases: per layer (outputs,).
        output_mean, output_scale: standardise the sensor output, equal for every tap.
        reference_mean, reference_scale: undo the standardisation of the reference.
        output_unit, reference_unit: physical units of window samples and of the estimate.
    """

    weights: tuple[Array, ...]
    biases: tuple[Array, ...]
    output_mean: float
    output_scale: float
    reference_mean: float
    reference_scale: float
    output_unit: str = "V"
    reference_unit: str = "N"

    @property
    def sizes(self) -> tuple[int, ...]:
        """Layer widths from the window to the estimate, for example (15, 120, 70, 35, 1)."""
        return (self.weights[0].shape[0], *(w.shape[1] for w in self.weights))

    def arrays(self) -> dict[str, Array]:
        parameters = {f"weight_{i}": w for i, w in enumerate(self.weights)}
        return parameters | {f"bias_{i}": b for i, b in enumerate(self.biases)}

    def settings(self) -> dict[str, float | str]:
        return {name: getattr(self, name) for name in (*_SCALES, *_UNITS)}

    @classmethod
    def from_arrays(cls, arrays: dict[str, Array], settings: dict[str, float | str]) -> "Network":
        depth = sum(name.startswith("weight_") for name in arrays)
        weights, biases = (tuple(arrays[f"{name}_{i}"] for i in range(depth)) for name in ("weight", "bias"))
        scalars: dict[str, Any] = {name: float(settings[name]) for name in _SCALES}
        scalars |= {name: str(settings[name]) for name in _UNITS}
        return cls(weights, biases, **scalars)

    @cached_property
    def id(self) -> str:
        return content_sha256(self.arrays(), self.settings())

    @cached_property
    def folded(self) -> tuple[tuple[Array, Array], ...]:
        """Layers (inputs, outputs), (outputs,) with all scales folded in but for `output_mean`."""
        # The mean stays outside: in the bias it would cost the digits of a small swing.
        weights, biases = list(self.weights), list(self.biases)
        weights[0] = weights[0] / self.output_scale
        weights[-1] = weights[-1] * self.reference_scale
        biases[-1] = biases[-1] * self.reference_scale + self.reference_mean
        return tuple(zip(weights, biases, strict=True))

    @cached_property
    def _folded(self) -> tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]:
        return tuple((w.astype(np.float32), b.astype(np.float32)) for w, b in self.folded)

    def evaluate(self, windows: Array) -> Array:
        """Estimate the reference for every window.

        Args:
            windows: (n, taps) in `output_unit`, newest sample last, in the source's window space.

        Returns:
            (n,) estimates in `reference_unit`, in float32: within about 1e-5 of the full scale.
        """
        estimates = np.empty(len(windows))
        for start in range(0, len(windows), CHUNK):
            # Centring before float32 keeps the small swing on a large rest value.
            hidden = (windows[start : start + CHUNK] - self.output_mean).astype(np.float32)
            for weight, bias in self._folded[:-1]:
                hidden = hidden @ weight
                hidden += bias
                np.maximum(hidden, 0, out=hidden)
            weight, bias = self._folded[-1]
            estimates[start : start + CHUNK] = (hidden @ weight + bias)[:, 0]
        return estimates

    def evaluate_exactly(self, windows: Array) -> Array:
        """Return estimates f(x) in float64: slower, and independent of the number of windows in a call.

        Returns:
            (n,) estimates in `reference_unit`.
        """
        hidden = (windows - self.output_mean) / self.output_scale
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            hidden = np.maximum(hidden @ weight + bias, 0.0)
        estimate = hidden @ self.weights[-1] + self.biases[-1]
        return np.asarray(estimate[:, 0] * self.reference_scale + self.reference_mean)

    def gradient(self, windows: Array) -> tuple[Array, Array]:
        """Return estimates f(x) and the gradient ∂f/∂x over the taps, in float32 like `evaluate`.

        Returns:
            (n,) estimates and (n, taps) their derivatives, reference unit per output unit.
        """
        # By hand and not by torch: the batch estimates without importing it.
        hidden, active = (windows - self.output_mean).astype(np.float32), []
        for weight, bias in self._folded[:-1]:
            hidden = hidden @ weight
            hidden += bias
            active.append(hidden > 0)
            np.maximum(hidden, 0, out=hidden)
        weight, bias = self._folded[-1]
        estimate = (hidden @ weight + bias)[:, 0].astype(np.float64)
        slope: NDArray[np.float32] = np.broadcast_to(weight[:, 0], hidden.shape)
        for (weight, _), on in zip(reversed(self._folded[:-1]), reversed(active), strict=True):
            slope = (slope * on) @ weight.T
        return estimate, slope.astype(np.float64)
