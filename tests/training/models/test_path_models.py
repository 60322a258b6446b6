"""WGAN-GP over points of paths: what it learns, and how its graph answers."""

import numpy as np
import onnxruntime
import pytest
import torch

from cspace.worlds.planar.arm import TWO_LINK
from tests.training.models.builders import run
from tests.training.models.path_builders import LATENT, arrays
from training.config import PathGanConfig
from training.models.checkpoint import seeded_initialisation
from training.models.paths import Condition, PathGanModule
from training.paths.bundling import point_graph

SMALL = PathGanConfig(hidden=32, layers=2, critic_hidden=32, critic_layers=2, steps=40, batch_size=64)


def path_module(**sizes):
    with seeded_initialisation(0):
        return PathGanModule(SMALL, arrays(**sizes).samples(), 0, TWO_LINK.space)


def trained():
    module = path_module(count=1, scenarios=1)
    first = run(module, 1).metrics()
    return run(module, SMALL.steps - 1).eval(), first


def test_the_critics_steps_change_the_generator_and_tell_their_losses():
    module, first = trained()
    assert set(first) == {"critic_loss", "wasserstein_estimate", "gradient_penalty", "generator_loss"}
    assert all(np.isfinite(list(module.metrics().values())))
    fresh = path_module(count=1, scenarios=1)
    before, after = fresh.net.state_dict(), module.net.state_dict()
    assert any(not torch.equal(before[name], after[name]) for name in before)


def feeds(names, rows=5, dim=2):
    rng = np.random.default_rng(1)
    shapes = {
        "latent": (rows, LATENT), "start": (rows, dim), "goal": (rows, dim),
        "noise": (rows, names.get("noise", 1)),
    }  # fmt: skip
    found = {name: rng.random(shapes[name], dtype=np.float32) for name in names}
    for name in {"start", "goal"} & set(found):
        found[name][:] = found[name][0]
    return found


def answer(model, fed, output="samples"):
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    assert {entry.name for entry in session.get_inputs()} == set(fed)
    return session.run([output], fed)[0]


@pytest.mark.slow
def test_a_graph_answers_as_the_network_does():
    module = path_module().eval()
    graph = point_graph(module.net, LATENT)
    names = {item.name: item.shape[0] for item in graph.random_inputs}
    fed = feeds(names | dict.fromkeys(["latent", "start", "goal"], 0))
    tensors = {key: torch.tensor(value) for key, value in fed.items()}
    with torch.no_grad():
        condition = Condition(tensors["latent"], tensors["start"], tensors["goal"])
        wanted = module.net(condition, tensors["noise"])
    np.testing.assert_allclose(answer(graph.model, fed)[:, 0], wanted, atol=1e-4)
    one = {key: value[:1] for key, value in fed.items()}
    assert answer(graph.model, one).shape == (1, 1, 2)
