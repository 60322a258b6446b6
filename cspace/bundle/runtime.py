"""onnxruntime: sessions within limits of time and memory, and the graphs of a bundle."""

import math
import os
import re
from collections.abc import Callable, Mapping
from collections.abc import Set as AbstractSet
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.bundle.files import (
    ENCODER_FILE,
    FIELD_FILE,
    GENERATOR_FILE,
    MAP_FILE,
    NOVELTY_FILE,
    VALIDITY_FILE,
    BundleFiles,
)
from cspace.bundle.spec import MAP, OCCUPANCY, PICTURE, WAYS, BundleSpec
from cspace.errors import BundleError, BundleIntegrityError
from cspace.world import CheckCancelled

# Of all sessions of a process together, weights aside; in a container at most this share of its limit.
ARENA_BYTES, CONTAINER_SHARE = 512 * 2**20, 0.5

_LONGEST = 300
# The folders of a path, of whatever kind; its last part stays.
_FOLDERS = re.compile(r"(?:[A-Za-z]:)?(?:[\w.~+-]*[/\\])+")


@cache
def onnx_runtime() -> Any:
    """The module ``onnxruntime``; official builds report on their use to their maker unless told not to."""
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    import onnxruntime  # noqa: PLC0415 - only after the variable is set

    return onnxruntime


@cache
def share_arena() -> None:
    """Give all sessions of this process one arena, which fails to grow beyond :data:`ARENA_BYTES`."""
    ort, container = onnx_runtime(), container_bytes()
    most = ARENA_BYTES if container is None else min(ARENA_BYTES, int(container * CONTAINER_SHARE))
    place = ort.OrtMemoryInfo("Cpu", ort.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0, ort.OrtMemType.DEFAULT)
    # Another thread, or whoever else uses onnxruntime here, may have come first.
    with suppress(*onnx_errors()):
        grows_as_needed = {"max_mem": most, "arena_extend_strategy": 1}
        ort.create_and_register_allocator(place, ort.OrtArenaCfg(grows_as_needed))


def container_bytes() -> int | None:
    """The memory limit of the container that this process is in; None without one."""
    with suppress(OSError, ValueError):
        return int(Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii"))
    return None


@cache
def onnx_errors() -> tuple[type[Exception], ...]:
    """What onnxruntime raises; its exceptions share no base below Exception."""
    state = vars(onnx_runtime().capi.onnxruntime_pybind11_state)
    kinds = [kind for kind in state.values() if isinstance(kind, type) and issubclass(kind, Exception)]
    return (*kinds, RuntimeError, ValueError, MemoryError)


def message_of(error: BaseException) -> str:
    """A library's message, without folders of the machine and of a bounded length."""
    text = str(error) or type(error).__name__
    return _FOLDERS.sub("", text[: 4 * _LONGEST])[:_LONGEST]


# Bound the memory and the time of one call; fixed sizes, so that they can not move a result. What one call
# of a path sampler draws comes in the order of the path, so it is drawn in larger parts; a place costs far
# less than a configuration.
CHUNK_ROWS, PATH_CHUNK_ROWS = 512, 4096


def chunked(
    run: Callable[[slice], NDArray[np.float32]],
    rows: int,
    check_cancelled: CheckCancelled,
    chunk_rows: int = CHUNK_ROWS,
) -> NDArray[np.float32]:
    """What ``run`` gives for all rows, in their order; ``rows`` is at least 1."""
    parts = []
    for at in range(0, rows, chunk_rows):
        if at:
            check_cancelled()
        parts.append(run(slice(at, at + chunk_rows)))
    return np.concatenate(parts)


# A picture's map is computed once and kept with it.
MAX_OUTPUT_ELEMENTS = 2**24
_FATAL = 4
# What the arena says when it may not grow.
_FULL = "Available memory of"


class Graph:
    """One opened graph with fixed names."""

    def __init__(
        self,
        name: str,
        model: bytes,
        inputs: set[str],
        outputs: set[str],
        optional: AbstractSet[str] = frozenset(),
    ) -> None:
        self._name = name
        share_arena()
        try:
            self._session = onnx_runtime().InferenceSession(
                model, _options(), providers=["CPUExecutionProvider"]
            )
        except onnx_errors() as error:
            raise BundleIntegrityError(
                f"{name} cannot be opened", expected="an ONNX graph", got=message_of(error)
            ) from error
        self.inputs = {node.name for node in self._session.get_inputs()}
        self._shapes = {node.name: node.shape for node in self._session.get_outputs()}
        self.outputs = set(self._shapes)
        if self.inputs - optional != inputs - optional or not outputs <= self.outputs:
            raise BundleIntegrityError(
                f"{name} has other inputs or outputs",
                expected=f"{sorted(inputs)} -> {sorted(outputs)}",
                got=f"{sorted(self.inputs)} -> {sorted(self.outputs)}"[:500],
            )

    def fixed_shape(self, output: str) -> tuple[int, ...]:
        """The shape of an output that is the same for every feed."""
        found = self._shapes[output]
        is_fixed = all(isinstance(size, int) and size >= 0 for size in found)
        if not is_fixed or math.prod(found) > MAX_OUTPUT_ELEMENTS:
            raise BundleIntegrityError(
                f"{self._name}: the shape of {output} is not fixed", got=str(found)[:200]
            )
        return tuple(found)

    def run(
        self, feeds: Mapping[str, NDArray[np.float32]], outputs: Mapping[str, tuple[int, ...]]
    ) -> dict[str, NDArray[np.float32]]:
        """The outputs by name, float32 of the shapes asked for."""
        options = onnx_runtime().RunOptions()
        try:
            try:
                found = self._session.run(list(outputs), dict(feeds), options)
            except onnx_errors() as error:
                if _FULL not in str(error):
                    raise
                # Such a run gives back at its end what earlier runs left in pieces, failed or not.
                options.add_run_config_entry("memory.enable_memory_arena_shrinkage", "cpu:0")
                found = self._session.run(list(outputs), dict(feeds), options)
        except onnx_errors() as error:
            raise BundleError(f"{self._name} failed", got=message_of(error)) from error
        return {
            name: self._checked(name, array, shape)
            for (name, shape), array in zip(outputs.items(), found, strict=True)
        }

    def _checked(self, name: str, array: Any, shape: tuple[int, ...]) -> NDArray[np.float32]:
        result = np.asarray(array)
        if result.shape != shape or result.dtype != np.float32 or not np.all(np.isfinite(result)):
            raise BundleError(
                f"{self._name}: {name} does not fit",
                expected=f"finite float32 {shape}",
                got=f"{result.dtype} {result.shape}",
            )
        return result


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


@dataclass(frozen=True, slots=True, eq=False)
class GraphSet:
    """The graphs; None for what a bundle is without."""

    encoder: Graph
    generator: Graph | None
    validity: Graph | None
    novelty: Graph | None
    map: Graph | None
    field: Graph | None


def open_graphs(spec: BundleSpec, files: BundleFiles) -> GraphSet:
    """Open them, where those that the description speaks of are there, and no others."""

    def opened(
        name: str, inputs: set[str], output: str, optional: AbstractSet[str] = frozenset()
    ) -> Graph | None:
        model = files.contents.get(name)
        return None if model is None else Graph(name, model, inputs, {output}, optional)

    noise = {item.name for item in spec.random_inputs}
    encoder = Graph(ENCODER_FILE, files.contents[ENCODER_FILE], {PICTURE}, {"mu", "sigma"})
    seen = opened(MAP_FILE, {PICTURE}, MAP)
    if seen is not None:
        seen.fixed_shape(MAP)
    generator = opened(GENERATOR_FILE, {"latent", *noise, *spec.conditions}, "samples")
    validity = opened(
        VALIDITY_FILE, {PICTURE, "configurations"}, "confidence", set() if seen is None else {MAP}
    )
    field = opened(FIELD_FILE, {PICTURE}, OCCUPANCY)
    novelty = opened(NOVELTY_FILE, {PICTURE, "mu"}, "scores")
    map_is_used = spec.looks_at_map or (validity is not None and MAP in validity.inputs)
    for name, graph, is_used, beside in (
        (GENERATOR_FILE, generator, spec.model_kind != WAYS, "a model kind that has one"),
        (MAP_FILE, seen, map_is_used, "the condition map"),
        (NOVELTY_FILE, novelty, spec.novelty_quantiles is not None, "novelty_quantiles"),
    ):
        if (graph is None) == is_used:
            raise BundleIntegrityError(f"the bundle has {name} without {beside}, or the other way round")
    if validity is None and spec.model_kind == WAYS:
        raise BundleIntegrityError("a bundle of paths has no validity head", expected=VALIDITY_FILE)
    return GraphSet(encoder, generator, validity, novelty, seen, field)
