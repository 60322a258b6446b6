"""Networks to ONNX graphs whose randomness is an input, as the bundle asks for."""

import contextlib
import io
import logging
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from cspace.bundle import RandomInput
from cspace.space import JointSpace
from training.models.joints import Joints

OPSET = 18


def pictures(count: int, size: int | Sequence[int]) -> Tensor:
    """Pictures of a side, or of a whole size, channels first."""
    return torch.zeros(count, *((3, size, size) if isinstance(size, int) else size))


def encoder_graph(encoder: nn.Module, pixels: int | Sequence[int]) -> bytes:
    """ONNX bytes: ``image`` (b, 3, P, P), or of the size given, to ``mu`` and ``sigma`` (b, L)."""

    def mean_and_deviation(image: Tensor) -> tuple[Tensor, Tensor]:
        mu, log_variance = encoder(image)
        return mu, (log_variance / 2.0).exp()

    graph, inputs = Graph(mean_and_deviation, encoder), (pictures(2, pixels),)
    return exported(graph, inputs, ["image"], ["mu", "sigma"], batched("images", 1))


def blind_encoder_graph(size: Sequence[int]) -> bytes:
    """ONNX bytes of an encoder that sees nothing: ``image`` to ``mu`` (b, 1), 0, and ``sigma`` (b, 1), 1."""
    return encoder_graph(Graph(lambda image: (0.0 * image.flatten(1)[:, :1],) * 2), size)


def novelty_graph(scores: nn.Module, pixels: int | Sequence[int], latent_dim: int) -> bytes:
    """ONNX bytes: ``image`` (1, 3, P, P), or of the size given, and ``mu`` (1, L) to ``scores`` (2,)."""
    inputs = (pictures(1, pixels), torch.zeros(1, latent_dim))
    graph = Graph(lambda image, mu: scores(image, mu).squeeze(0), scores)
    return exported(graph, inputs, ["image", "mu"], ["scores"], ({}, {}))


class Sampler(nn.Module):
    """A trained generator as a bundle holds it: its randomness, and the picture, are inputs.

    ``forward`` takes latents (m, L), the random inputs in their order and, where it looks at it, the picture
    (1, ...), and gives (m, K, d) rad.
    """

    random_inputs: tuple[RandomInput, ...]
    looks_at_picture = False
    samples_per_latent = 1
    # Mean and standard deviation (d,) rad that the graph's angles are standardised by.
    scale: tuple[Tensor, Tensor] | None = None


def generator_graph(sampler: Sampler, latent_dim: int, pixels: int = 0) -> bytes:
    """ONNX bytes: ``latent`` (m, L), the random inputs and ``image`` to ``samples`` (m, K, d) rad."""
    shapes = {one.name: one.shape for one in sampler.random_inputs}
    inputs = [torch.zeros(2, latent_dim), *(torch.zeros(2, *shape) for shape in shapes.values())]
    names, axes = ["latent", *shapes], batched("latents", len(inputs))
    if sampler.looks_at_picture:
        inputs.append(pictures(1, pixels))
        names.append("image")
        axes = (*axes, {})
    return exported(sampler, tuple(inputs), names, ["samples"], axes)


def uniform_graph(space: JointSpace) -> bytes:
    """ONNX bytes: ``latent`` (m, 1) and ``base`` (m, d), uniform on the torus, to ``samples`` (m, 1, d) rad.

    They are uniform in the joint space, whatever the latent is.
    """
    joints, inputs = Joints(space), (torch.zeros(2, 1), torch.zeros(2, space.dim))
    graph = Graph(lambda latent, base: (joints.from_torus(base) + 0.0 * latent)[:, None], joints)
    return exported(graph, inputs, ["latent", "base"], ["samples"], batched("latents", 2))


class Graph(nn.Module):
    """A function of tensors, and the networks that it calls."""

    def __init__(self, function: Callable[..., Any], *networks: nn.Module) -> None:
        super().__init__()
        self.function, self.networks = function, nn.ModuleList(networks)

    def forward(self, *inputs: Tensor) -> Any:
        """The function's value."""
        return self.function(*inputs)


def batched(axis: str, count: int) -> tuple[dict[int, Any], ...]:
    """Every input's first axis is one of a free length."""
    batch = torch.export.Dim(axis, min=1)
    return tuple({0: batch} for _ in range(count))


def exported(
    module: nn.Module,
    inputs: tuple[Tensor, ...],
    names: list[str],
    outputs: list[str],
    free_axes: tuple[Any, ...],
) -> bytes:
    """A module's graph, self-contained and without traces of the machine."""
    module.eval()
    with _quiet():
        program = torch.onnx.export(
            module,
            inputs,
            input_names=names,
            output_names=outputs,
            dynamic_shapes=(free_axes,) if isinstance(module, Graph) else free_axes,
            opset_version=OPSET,
            dynamo=True,
            verbose=False,
            external_data=False,
        )
    if program is None:
        raise RuntimeError("torch.onnx.export returned nothing")
    return _without_traces(program.model_proto)


def _without_traces(model: Any) -> bytes:
    """The graph's bytes without the exporter's stack traces, which name folders of the machine it ran on."""
    graph = model.graph
    for part in (
        model,
        graph,
        *graph.node,
        *graph.input,
        *graph.output,
        *graph.value_info,
        *graph.initializer,
    ):
        part.ClearField("metadata_props")
        part.ClearField("doc_string")
    serialised: bytes = model.SerializeToString()
    return serialised


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """The exporter prints and warns about its own internals; none of it concerns the caller."""
    loggers = [logging.getLogger(name) for name in ("torch.onnx", "onnxscript")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
