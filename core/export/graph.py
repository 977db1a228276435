"""g = f∘γ as plain nodes and arrays, for a graph format such as ONNX without its libraries."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softcal.core.export.compile_map import Curve, Linear, MapForm
from softcal.core.export.loader import CLAMPED, OUT_OF_RANGE
from softcal.core.export.quantise import Limits
from softcal.core.export.shape_mix import Mix
from softcal.core.network.network import Network
from softcal.core.windows import TAPS

Constant = NDArray[np.float32] | NDArray[np.int64]


@dataclass(frozen=True)
class Node:
    """One operation of the ONNX operator set, with the names of its inputs and output."""

    operator: str
    inputs: tuple[str, ...]
    output: str
    attributes: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Graph:
    """Nodes in order, from `window` (n, TAPS) to `estimate`, `lower`, `upper` and `flag`, each
    (n,), with `source_window` (n, TAPS) on the way.
    """

    nodes: tuple[Node, ...]
    constants: Mapping[str, Constant]


def compose(form: MapForm, network: Network, limits: Limits) -> Graph:
    """Join a compiled map, f and the unit's limits in float32; the curve is a sum of ramps.

    The estimate is clamped, the interval that of its band, the flag a sum of OUT_OF_RANGE and
    CLAMPED: all as on the device.
    """
    parts = (
        _curve(form.curve, "source_window" if form.linear is None else "curved"),
        _linear(form.linear, "window" if form.curve is None else "curved"),
        _network(network),
        _limits(limits),
    )
    constants = {name: value for _, of_part in parts for name, value in of_part.items()}
    return Graph(tuple(node for nodes, _ in parts for node in nodes), constants)


def _curve(curve: Curve | None, result: str) -> tuple[list[Node], dict[str, Constant]]:
    if curve is None:
        return [], {}
    # value = values[0] + Σ (change of slope at knot i) relu(x - knot i); then constant.
    slopes = np.diff(curve.values) / np.diff(curve.outputs)
    changes = np.diff(np.concatenate([[0.0], slopes, [0.0]]))
    nodes = [
        Node("Unsqueeze", ("window", "last_axis"), "samples"),
        Node("Sub", ("samples", "knots"), "beyond_knots"),
        Node("Relu", ("beyond_knots",), "ramps"),
        Node("MatMul", ("ramps", "slope_changes"), "risen"),
        Node("Squeeze", ("risen", "last_axis"), "rise"),
        Node("Add", ("rise", "first_value"), result),
    ]
    return nodes, {
        "last_axis": np.array([2], dtype=np.int64),
        "knots": curve.outputs.astype(np.float32),
        "slope_changes": changes[:, None].astype(np.float32),
        "first_value": np.array(curve.values[0], dtype=np.float32),
    }


def _linear(linear: Linear | Mix | None, entering: str) -> tuple[list[Node], dict[str, Constant]]:
    if linear is None:
        return [], {}
    nodes = [
        Node("MatMul", (entering, "map_matrix"), "map_product"),
        Node("Add", ("map_product", "map_offset"), "source_window"),
    ]
    return nodes, {"map_matrix": linear.matrix.T.astype(np.float32), "map_offset": linear.offset.astype(np.float32)}


def _network(network: Network) -> tuple[list[Node], dict[str, Constant]]:
    layers = network.folded
    nodes = [Node("Sub", ("source_window", "output_mean"), "hidden_0")]
    constants: dict[str, Constant] = {
        "output_mean": np.full(TAPS, network.output_mean, dtype=np.float32),
        "estimate_axis": np.array([1], dtype=np.int64),
    }
    for i, (weight, bias) in enumerate(layers):
        constants |= {f"weight_{i}": weight.astype(np.float32), f"bias_{i}": bias.astype(np.float32)}
        nodes += [
            Node("MatMul", (f"hidden_{i}", f"weight_{i}"), f"product_{i}"),
            Node("Add", (f"product_{i}", f"bias_{i}"), f"sum_{i}"),
        ]
        if i < len(layers) - 1:
            nodes.append(Node("Relu", (f"sum_{i}",), f"hidden_{i + 1}"))
    nodes.append(Node("Squeeze", (f"sum_{len(layers) - 1}", "estimate_axis"), "raw_estimate"))
    return nodes, constants


def _limits(limits: Limits) -> tuple[list[Node], dict[str, Constant]]:
    nodes = [
        Node("Clip", ("raw_estimate", "estimate_low", "estimate_high"), "estimate"),
        Node("Unsqueeze", ("estimate", "estimate_axis"), "estimate_column"),
        Node("Greater", ("estimate_column", "levels"), "is_above"),
        Node("Where", ("is_above", "one", "nought"), "above"),
        *_band("minus"),
        Node("Sub", ("estimate", "minus"), "lower"),
        *_band("plus"),
        Node("Add", ("estimate", "plus"), "upper"),
        *_outside("window", "output_low", "output_high", "sample"),
        Node("Where", ("sample_outside", "one", "nought"), "samples_outside"),
        Node("ReduceMax", ("samples_outside",), "most_outside", {"axes": [1], "keepdims": 0}),
        Node("Greater", ("most_outside", "nought"), "window_outside"),
        Node("Where", ("window_outside", "out_of_range", "no_flag"), "range_flag"),
        *_outside("raw_estimate", "estimate_low", "estimate_high", "estimate"),
        Node("Where", ("estimate_outside", "clamped", "no_flag"), "clamp_flag"),
        Node("Add", ("range_flag", "clamp_flag"), "flag"),
    ]
    floats = {
        name: np.array(getattr(limits, name), dtype=np.float32)
        for name in ("output_low", "output_high", "estimate_low", "estimate_high", "levels")
    }
    for side, half_widths in (("minus", limits.minus), ("plus", limits.plus)):
        floats |= {f"{side}_changes": np.diff(half_widths)[:, None].astype(np.float32)}
        floats |= {f"{side}_first": np.array(half_widths[0], dtype=np.float32)}
    flags = {"out_of_range": OUT_OF_RANGE, "clamped": CLAMPED, "no_flag": 0}
    return nodes, {
        "one": np.array(1, dtype=np.float32),
        "nought": np.array(0, dtype=np.float32),
        **floats,
        **{name: np.array(value, dtype=np.int64) for name, value in flags.items()},
    }


def _band(side: str) -> list[Node]:
    """The reach of the interval on one side: the first band's, changed at every level below."""
    return [
        Node("MatMul", ("above", f"{side}_changes"), f"{side}_column"),
        Node("Squeeze", (f"{side}_column", "estimate_axis"), f"{side}_change"),
        Node("Add", (f"{side}_change", f"{side}_first"), side),
    ]


def _outside(value: str, low: str, high: str, name: str) -> list[Node]:
    return [
        Node("Less", (value, low), f"{name}_below"),
        Node("Greater", (value, high), f"{name}_above"),
        Node("Or", (f"{name}_below", f"{name}_above"), f"{name}_outside"),
    ]
