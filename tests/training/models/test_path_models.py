"""WGAN-GP over points of paths: what it learns, and how its graph answers."""

import numpy as np
import onnxruntime
import pytest
import torch

from cspace.worlds.planar.arm import TWO_LINK
from tests.training.models.builders import run
from tests.training.models.path_builders import LATENT, samples
from training.config import PathGanConfig
from training.models.checkpoint import seeded_initialisation
from training.models.paths import Condition, PathGanModule, point_graph

SMALL = PathGanConfig(hidden=32, layers=2, critic_hidden=32, critic_layers=2, steps=40, batch_size=64)


def path_module(**sizes):
    with seeded_initialisation(0):
        return PathGanModule(SMALL, samples(**sizes), 0, TWO_LINK.space)


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


@pytest.mark.slow
def test_a_graph_answers_as_the_network_does():
    net, rng = path_module().net.eval(), torch.Generator().manual_seed(1)
    sizes = {"latent": LATENT, "start": 2, "goal": 2, "noise": net.noise_dim}
    session = onnxruntime.InferenceSession(point_graph(net, LATENT), providers=["CPUExecutionProvider"])
    for rows in (1, 5):
        fed = {name: torch.rand(rows, size, generator=rng) for name, size in sizes.items()}
        with torch.no_grad():
            wanted = net(Condition(fed["latent"], fed["start"], fed["goal"]), fed["noise"])
        (found,) = session.run(["samples"], {name: value.numpy() for name, value in fed.items()})
        np.testing.assert_allclose(found, wanted.unsqueeze(1), atol=1e-4)
