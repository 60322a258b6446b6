"""The ONNX graphs of a bundle: opened from memory, on one thread, with onnxruntime's errors mapped."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.bundle.runtime import onnx_errors, onnx_runtime
from cspace.errors import BundleError, BundleIntegrityError

# The protobuf bytes of an external-data entry: key (field 1) "location", value (field 2).
_EXTERNAL_DATA = b"\n\x08location\x12"
_FATAL = 4


class Graph:
    """One graph with fixed names.

    Args:
        name: the file's name, for messages.
        model: the file's bytes.
        inputs: the names that it must take, no more and no fewer.
        outputs: the names that it must give.

    Raises:
        BundleIntegrityError: not a graph, other names, or weights outside the file.
    """

    def __init__(self, name: str, model: bytes, inputs: set[str], outputs: set[str]) -> None:
        if _EXTERNAL_DATA in model:
            raise BundleIntegrityError(
                f"{name} keeps weights outside the bundle",
                expected="a graph that is self-contained",
                remedy="export it without external data",
            )
        try:
            self._session = onnx_runtime().InferenceSession(
                model, _options(), providers=["CPUExecutionProvider"]
            )
        except onnx_errors() as error:
            raise BundleIntegrityError(
                f"{name} cannot be opened", expected="an ONNX graph", got=str(error)
            ) from error
        self._name = name
        found_in = {node.name for node in self._session.get_inputs()}
        found_out = {node.name for node in self._session.get_outputs()}
        if found_in != inputs or not outputs <= found_out:
            raise BundleIntegrityError(
                f"{name} has other inputs or outputs",
                expected=f"{sorted(inputs)} -> {sorted(outputs)}",
                got=f"{sorted(found_in)} -> {sorted(found_out)}",
            )

    def sizes(self, output: str) -> tuple[int, ...]:
        """The shape of an output that is the same for every feed.

        Raises:
            BundleIntegrityError: it depends on what is fed.
        """
        (found,) = (node.shape for node in self._session.get_outputs() if node.name == output)
        if not all(isinstance(size, int) for size in found):
            raise BundleIntegrityError(
                f"{self._name}: the shape of {output} is not fixed", expected="numbers", got=str(found)
            )
        return tuple(found)

    def run(
        self, feeds: Mapping[str, NDArray[np.float32]], outputs: Mapping[str, tuple[int, ...]]
    ) -> dict[str, NDArray[np.float32]]:
        """Evaluate the graph.

        Args:
            feeds: input name to array.
            outputs: output name to the shape that it must have.

        Returns:
            Output name to float32 array.

        Raises:
            BundleError: the graph fails, or an output has another shape or is not finite.
        """
        try:
            found = self._session.run(list(outputs), dict(feeds))
        except onnx_errors() as error:
            raise BundleError(f"{self._name} failed", got=str(error)) from error
        return {
            name: self._checked(name, array, shape)
            for (name, shape), array in zip(outputs.items(), found, strict=True)
        }

    def _checked(self, name: str, array: Any, shape: tuple[int, ...]) -> NDArray[np.float32]:
        result = np.asarray(array)
        if result.shape != shape or result.dtype != np.float32:
            raise BundleError(
                f"{self._name}: {name} does not fit",
                expected=f"float32 {shape}",
                got=f"{result.dtype} {result.shape}",
            )
        if not np.all(np.isfinite(result)):
            raise BundleError(f"{self._name}: {name} is not finite", expected="finite numbers")
        return result


def _options() -> Any:
    ort = onnx_runtime()
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
    options.use_deterministic_compute = True
    # What fails is raised; the library's own lines on stderr would say it twice.
    options.log_severity_level = _FATAL
    return options
