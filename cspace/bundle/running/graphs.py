"""The ONNX graphs of a bundle: checked, opened, and held to the names and shapes of the description."""

import math
from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.bundle.running.deadlines import RUN_LIMIT_S
from cspace.bundle.running.sessions import Session
from cspace.errors import BundleError, BundleIntegrityError

# A picture's map is computed once and kept with it.
MAX_OUTPUT_ELEMENTS = 2**20


class Graph:
    """One graph with fixed names.

    Args:
        name: the file's name, for messages.
        model: the file's bytes, which have been checked.
        inputs: the names that it must take, no more and no fewer.
        outputs: the names that it must give.
        run_limit_s: how long a run may take.
        perhaps: names of inputs that it may take, too.

    Raises:
        BundleIntegrityError: not a graph, or other names.
    """

    def __init__(
        self,
        name: str,
        model: bytes,
        inputs: set[str],
        outputs: set[str],
        run_limit_s: float = RUN_LIMIT_S,
        perhaps: AbstractSet[str] = frozenset(),
    ) -> None:
        self._name = name
        self._session = Session(name, model, run_limit_s)
        found_in = {node.name for node in self._session.inputs()}
        found_out = {node.name for node in self._session.outputs()}
        self._inputs, self._outputs = found_in, found_out
        if found_in - perhaps != inputs - perhaps or not outputs <= found_out:
            raise BundleIntegrityError(
                f"{name} has other inputs or outputs",
                expected=f"{sorted(inputs)} -> {sorted(outputs)}",
                got=f"{sorted(found_in)} -> {sorted(found_out)}"[:500],
            )

    def takes(self, name: str) -> bool:
        """Whether it has such an input."""
        return name in self._inputs

    def gives(self, name: str) -> bool:
        """Whether it has such an output."""
        return name in self._outputs

    def sizes(self, output: str) -> tuple[int, ...]:
        """The shape of an output that is the same for every feed.

        Raises:
            BundleIntegrityError: it depends on what is fed, or is too large to be kept.
        """
        (found,) = (node.shape for node in self._session.outputs() if node.name == output)
        fixed = all(isinstance(size, int) and size >= 0 for size in found)
        if not fixed or math.prod(found) > MAX_OUTPUT_ELEMENTS:
            raise BundleIntegrityError(
                f"{self._name}: the shape of {output} is not fixed",
                expected=f"numbers, at most {MAX_OUTPUT_ELEMENTS} elements",
                got=str(found)[:200],
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
            BundleError: the graph fails or does not end, or an output has another shape or is not finite.
        """
        found = self._session.run(list(outputs), dict(feeds))
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
