"""onnxruntime's sessions: opened from checked bytes, run within limits of time and memory, errors mapped."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.bundle.running.deadlines import DEADLINES
from cspace.bundle.running.runtime import onnx_errors, onnx_runtime, said, share_arena
from cspace.errors import BundleError, BundleIntegrityError

_FATAL = 4
# What the arena says when it may not grow.
_FULL = "Available memory of"


class Session:
    """One opened graph.

    Args:
        name: the file's name, for messages.
        model: the file's bytes, which have been checked.
        limit_s: how long opening it and a run may take.

    Raises:
        BundleIntegrityError: onnxruntime does not open it.
    """

    def __init__(self, name: str, model: bytes, limit_s: float) -> None:
        self._name, self._limit_s = name, limit_s
        self._new_run = onnx_runtime().RunOptions
        share_arena()
        self._session = self._opened(model, _options())

    def inputs(self) -> list[Any]:
        """What it takes, as onnxruntime describes it."""
        return list(self._session.get_inputs())

    def outputs(self) -> list[Any]:
        """What it gives, as onnxruntime describes it."""
        return list(self._session.get_outputs())

    def run(self, outputs: list[str] | None, feeds: dict[str, NDArray[np.float32]]) -> Any:
        """The outputs, all for None.

        Raises:
            BundleError: the graph fails, does not end, or needs more memory than all graphs may have.
        """
        try:
            return self._run(outputs, feeds, self._new_run())
        except onnx_errors() as error:
            if _FULL not in str(error):
                raise BundleError(f"{self._name} failed", got=said(error)) from error
        # What earlier runs left in pieces is given back at the end of a run with this option, failed or not.
        again = self._new_run()
        again.add_run_config_entry("memory.enable_memory_arena_shrinkage", "cpu:0")
        try:
            return self._run(outputs, feeds, again)
        except onnx_errors() as error:
            raise BundleError(f"{self._name} failed", got=said(error)) from error

    def _run(self, outputs: list[str] | None, feeds: dict[str, NDArray[np.float32]], options: Any) -> Any:
        def end() -> None:
            options.terminate = True

        DEADLINES.begin(options, self._limit_s, end)
        try:
            return self._session.run(outputs, feeds, options)
        except onnx_errors() as error:
            if not options.terminate:
                raise
            raise BundleError(
                f"{self._name} did not end in time",
                expected=f"an answer within {self._limit_s:g} s",
                remedy="ask for fewer samples, or export a graph that computes less",
            ) from error
        finally:
            DEADLINES.done(options)

    def _opened(self, model: bytes, options: Any) -> Any:
        """A session; between two of its steps, opening one is ended like a run."""
        cancel = options.set_load_cancellation_flag
        try:
            with DEADLINES.ended_by(self._limit_s, lambda: cancel(True)):  # noqa: FBT003 - the library's way
                return onnx_runtime().InferenceSession(model, options, providers=["CPUExecutionProvider"])
        except onnx_errors() as error:
            raise BundleIntegrityError(
                f"{self._name} cannot be opened", expected="an ONNX graph", got=said(error)
            ) from error


def _options() -> Any:
    ort = onnx_runtime()
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
    options.use_deterministic_compute = True
    # Never guessed from the bytes: files of the library's own format would pass by the check.
    options.add_session_config_entry("session.load_model_format", "ONNX")
    # All sessions of the process take their memory from one arena of a bounded size.
    options.add_session_config_entry("session.use_env_allocators", "1")
    options.add_session_config_entry("session.use_device_allocator_for_initializers", "1")
    # What fails is raised; the library's own lines on stderr would say it twice.
    options.log_severity_level = _FATAL
    return options
