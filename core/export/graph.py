"""g = f∘γ as plain nodes and arrays: what a graph format such as ONNX needs, without any of its libraries."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softcal.core.export.compile_map import Curve, Linear, MapForm
from softcal.core.export.quantise import folded_layers
from softcal.core.export.shape_mix import Mix
from softcal.core.network.network import Network
from softcal.core.windows import TAPS

Constant = NDArray[np.float32] | NDArray[np.int64]


@dataclass(frozen=True)
class Node:
    """One operation of the ONNX operator set: operator, names of its inputs, name of its output."""

    operator: str
    inputs: tuple[str, ...]
    output: str


@dataclass(frozen=True, eq=False)
class Graph:
    """Nodes in order, from `window` (n, TAPS) to `estimate` (n,), with `source_window` (n, TAPS) on the way."""

    nodes: tuple[Node, ...]
    constants: Mapping[str, Constant]


def compose(form: MapForm, network: Network) -> Graph:
    """Join a compiled map and f in float32: the curve is a sum of rectified ramps between its knots."""
    curve_nodes, curve_constants = _curve(form.curve, "source_window" if form.linear is None else "curved")
    linear_nodes, linear_constants = _linear(form.linear, "window" if form.curve is None else "curved")
    net_nodes, net_constants = _network(network)
    nodes = (*curve_nodes, *linear_nodes, *net_nodes)
    return Graph(nodes, {**curve_constants, **linear_constants, **net_constants})


def _curve(curve: Curve | None, result: str) -> tuple[list[Node], dict[str, Constant]]:
    if curve is None:
        return [], {}
    # value = values[0] + Σ (change of slope at knot i) relu(x - knot i); constant beyond the end knots.
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
    layers = folded_layers(network)
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
    nodes.append(Node("Squeeze", (f"sum_{len(layers) - 1}", "estimate_axis"), "estimate"))
    return nodes, constants
