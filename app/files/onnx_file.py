"""An ONNX model from plain nodes and arrays: the same bytes every time, no torch."""

from collections.abc import Mapping

from onnx import TensorProto, checker, helper, numpy_helper

from softcal.core.export.graph import Graph
from softcal.core.windows import TAPS

OPSET, IR_VERSION = 13, 8
"""Old enough for every runtime in the field, new enough for Squeeze with axes as input."""


def onnx_bytes(graph: Graph, metadata: Mapping[str, str]) -> bytes:
    """Return the model: `window` (n, 15), oldest sample first, in; `estimate`, `lower`, `upper`, `flag` (n,) out, and
    `source_window` (n, 15).
    """
    nodes = [
        helper.make_node(n.operator, list(n.inputs), [n.output], name=n.output, **n.attributes) for n in graph.nodes
    ]
    floats = TensorProto.FLOAT
    body = helper.make_graph(
        nodes,
        "softcal",
        [helper.make_tensor_value_info("window", floats, ["n", TAPS])],
        [
            *[helper.make_tensor_value_info(name, floats, ["n"]) for name in ("estimate", "lower", "upper")],
            helper.make_tensor_value_info("flag", TensorProto.INT64, ["n"]),
            helper.make_tensor_value_info("source_window", floats, ["n", TAPS]),
        ],
        [numpy_helper.from_array(array, name) for name, array in graph.constants.items()],
    )
    model = helper.make_model(
        body, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION, producer_name="softcal"
    )
    helper.set_model_props(model, dict(sorted(metadata.items())))
    checker.check_model(model, full_check=True)
    content: bytes = model.SerializeToString(deterministic=True)
    return content
