"""Copies of the shipped model that are a little or a lot worse than it is."""

from dataclasses import replace

import numpy as np
import onnx
from onnx import helper, numpy_helper

from cspace.bundle import Bundle, write_bundle
from inference_api.settings import PRETRAINED_FOLDER


def copy_of_shipped(folder, *, noise=0.0, **changes):
    """The shipped model with a changed description, and noise of so many rad on what its generator draws."""
    shipped = Bundle.load(PRETRAINED_FOLDER)
    names = ("encoder", "generator", "novelty", "validity")
    graphs = {name: (PRETRAINED_FOLDER / f"{name}.onnx").read_bytes() for name in names}
    if noise:
        graphs["generator"] = noisy(graphs["generator"], noise)
    return Bundle.load(write_bundle(folder, replace(shipped.spec, **changes), graphs))


def noisy(graph, noise_rad):
    """The generator with noise added to its samples."""
    model = onnx.load_from_string(graph)
    (output,) = model.graph.output
    clean = f"{output.name}.clean"
    for node in model.graph.node:
        node.output[:] = [clean if name == output.name else name for name in node.output]
    initial = {"wide": np.array(noise_rad, np.float32), "axes": np.array([1], np.int64)}
    model.graph.initializer.extend(numpy_helper.from_array(value, name) for name, value in initial.items())
    model.graph.node.extend(
        [
            helper.make_node("Mul", ["noise", "wide"], ["widened"]),
            helper.make_node("Unsqueeze", ["widened", "axes"], ["added"]),
            helper.make_node("Add", [clean, "added"], [output.name]),
        ]
    )
    return model.SerializeToString()
