"""onnxruntime's sessions: opened from checked bytes, run within a limit of time, with their errors mapped."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.bundle.onnx.folding import Folding
from cspace.bundle.onnx.tensors import MAX_ELEMENTS
from cspace.bundle.running.deadlines import DEADLINES
from cspace.bundle.running.runtime import onnx_errors, onnx_runtime, said
from cspace.errors import BundleError, BundleIntegrityError

_FATAL = 4


class Session:
    """One opened graph.

    Args:
        name: the file's name, for messages.
        model: the file's bytes, which have been checked.
        folding: how much it computes from constants, by that check.
        limit_s: how long a run may take.
        shapes: of those inputs whose shape the graph does not tell.

    Raises:
        BundleIntegrityError: onnxruntime does not open it.
        BundleError: what it computes from constants does not end in time.
    """

    def __init__(
        self, name: str, model: bytes, folding: Folding, limit_s: float, shapes: Mapping[str, tuple[int, ...]]
    ) -> None:
        self._name, self._limit_s = name, limit_s
        self._new_run = onnx_runtime().RunOptions
        if folding is Folding.TO_BE_TRIED:
            folding = self._tried(model, shapes)
        left_out = ["ConstantFolding"] if folding is Folding.UNSAFE else []
        self._session = self._opened(model, _options(), left_out)

    def inputs(self) -> list[Any]:
        """What it takes, as onnxruntime describes it."""
        return list(self._session.get_inputs())

    def outputs(self) -> list[Any]:
        """What it gives, as onnxruntime describes it."""
        return list(self._session.get_outputs())

    def run(self, outputs: list[str] | None, feeds: dict[str, NDArray[np.float32]]) -> Any:
        """The outputs, all for None.

        Raises:
            BundleError: the graph fails or does not end.
        """
        options = self._new_run()

        def end() -> None:
            options.terminate = True

        DEADLINES.begin(options, self._limit_s, end)
        try:
            return self._session.run(outputs, feeds, options)
        except onnx_errors() as error:
            if options.terminate:
                raise RunTooLongError(
                    f"{self._name} did not end in time",
                    expected=f"an answer within {self._limit_s:g} s",
                    remedy="ask for fewer samples, or export a graph that computes less",
                ) from error
            raise BundleError(f"{self._name} failed", got=said(error)) from error
        finally:
            DEADLINES.done(options)

    def _opened(self, model: bytes, options: Any, left_out: list[str]) -> Any:
        """A session; between two of its steps, opening one is ended like a run."""
        cancel = options.set_load_cancellation_flag
        try:
            with DEADLINES.ended_by(self._limit_s, lambda: cancel(True)):  # noqa: FBT003 - the library's way
                return onnx_runtime().InferenceSession(
                    model, options, providers=["CPUExecutionProvider"], disabled_optimizers=left_out
                )
        except onnx_errors() as error:
            raise BundleIntegrityError(
                f"{self._name} cannot be opened", expected="an ONNX graph", got=said(error)
            ) from error

    def _tried(self, model: bytes, shapes: Mapping[str, tuple[int, ...]]) -> Folding:
        """Compute the graph once as it stands, where it can be ended.

        What follows from constants is computed with it; opening the graph computes that again, without an
        end to it. Where the trial fails, for the zeros that it is fed do not fit, nobody knows.
        """
        options = _options()
        options.graph_optimization_level = onnx_runtime().GraphOptimizationLevel.ORT_DISABLE_ALL
        self._session = self._opened(model, options, [])
        feeds = {}
        for node in self.inputs():
            told = [size if isinstance(size, int) else 1 for size in node.shape]
            shape = shapes.get(node.name, tuple(told))
            if node.type != "tensor(float)" or math.prod(shape) > MAX_ELEMENTS:
                return Folding.UNSAFE
            feeds[node.name] = np.zeros(shape, dtype=np.float32)
        try:
            self.run(None, feeds)
        except RunTooLongError:
            raise
        except BundleError:
            return Folding.UNSAFE
        return Folding.QUICK


class RunTooLongError(BundleError):
    """A run did not end within its limit."""


def _options() -> Any:
    ort = onnx_runtime()
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
    options.use_deterministic_compute = True
    # Never guessed from the bytes: files of the library's own format would pass by the check.
    options.add_session_config_entry("session.load_model_format", "ONNX")
    # What fails is raised; the library's own lines on stderr would say it twice.
    options.log_severity_level = _FATAL
    return options
