"""An ONNX graph as it grows node by node; see `baselines.policies.onnx_export`."""

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from railenv.errors import ArgumentError
from railenv.units import FloatArray

_OPSET = 17
_IR_VERSION = 8


class Graph:
    """Nodes and constants of a model, named one after the other."""

    def __init__(self, onnx: Any) -> None:
        self._onnx = onnx
        self._nodes: list[Any] = []
        self._constants: list[Any] = []

    def keep(self, values: NDArray[Any]) -> str:
        """Return the name of a constant."""
        name = f"constant{len(self._constants)}"
        array = np.ascontiguousarray(values) if np.ndim(values) else np.asarray(values)
        self._constants.append(self._onnx.numpy_helper.from_array(array, name))
        return name

    def add(self, kind: str, *inputs: str, output: str = "", **attributes: Any) -> str:
        """Return the name of a node's output."""
        name = output or f"value{len(self._nodes)}"
        node = self._onnx.helper.make_node(kind, list(inputs), [name], **attributes)
        self._nodes.append(node)
        return name

    def times(self, value: str, matrix: FloatArray) -> str:
        """Return the name of value @ matrix.T, lanes first."""
        return self.add("MatMul", value, self.keep(np.array(matrix).T))

    def columns(self, value: str, first: int, end: int) -> str:
        """Return the name of some columns of a value."""
        ends = (self.keep(np.array([k], dtype=np.int64)) for k in (first, end, 1))
        return self.add("Slice", value, *ends)

    def model(self, features: int, actions: int, hidden: int, about: dict[str, Any]) -> bytes:
        """Return the content of the whole model."""
        helper, double = self._onnx.helper, self._onnx.TensorProto.DOUBLE

        def value(name: str, *columns: int) -> Any:
            return helper.make_tensor_value_info(name, double, ["lanes", *columns])

        graph = helper.make_graph(
            self._nodes,
            "railenv_policy",
            [value("features", features), value("told"), value("hidden", hidden)],
            [value("action", actions), value("next_hidden", hidden)],
            self._constants,
        )
        model = helper.make_model(
            graph,
            opset_imports=[helper.make_opsetid("", _OPSET)],
            ir_version=_IR_VERSION,
            producer_name="railenv",
        )
        helper.set_model_props(model, {"railenv_history": json.dumps(about)})
        self._onnx.checker.check_model(model)
        return model.SerializeToString()


def imported(name: str) -> Any:
    """Return the package onnx or onnxruntime.

    Raises:
        ArgumentError: It is not installed.
    """
    try:
        if name == "onnx":
            import onnx

            return onnx
        import onnxruntime

        return onnxruntime
    except ImportError:
        raise ArgumentError(
            f'{name} is not installed; pip install "railenv[onnx]", which brings it'
        ) from None
