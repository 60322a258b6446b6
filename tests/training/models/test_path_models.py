"""WGAN-GP over points of paths: what it learns, and how its graph answers."""

import numpy as np
import onnxruntime
import pytest
import torch

from cspace.worlds.planar.arm import TWO_LINK
from tests.training.models.builders import run
from tests.training.models.path_builders import LATENT, arrays
from training.config import PathTrainConfig
from training.models.paths import Condition, PathGanModule
from training.models.settings import PathGanConfig
from training.paths.bundling import point_graph
from training.trials.paths import make_path_module

SMALL = PathTrainConfig(
    wgan=PathGanConfig(hidden=32, layers=2, critic_hidden=32, critic_layers=2, steps=40, batch_size=64)
)


def trained(name):
    module = make_path_module(name, SMALL, arrays(count=1, scenarios=1), 0)
    first = run(module, 1).metrics()
    return run(module, SMALL.wgan.steps - 1).eval(), first


def test_the_critics_steps_change_the_generator_and_tell_their_losses():
    module, first = trained("wgan")
    assert set(first) == {"wasserstein_estimate", "gradient_penalty", "generator_loss"}
    assert all(np.isfinite(list(module.metrics().values())))
    fresh = make_path_module("wgan", SMALL, arrays(count=1, scenarios=1), 0)
    before, after = fresh.net.state_dict(), module.net.state_dict()
    assert any(not torch.equal(before[name], after[name]) for name in before)


@pytest.mark.slow
def test_a_guide_pulls_the_generator_its_way():
    class Guide(torch.nn.Module):
        def forward(self, points, condition, seen):
            del condition, seen
            return 50.0 * torch.cos(points[:, 0] - 1.0)

    found = {}
    given = arrays()
    config = SMALL.wgan.model_copy(update={"guide_weight": 1.0, "steps": 60})
    for name, guides in (("alone", []), ("guided", [Guide()])):
        torch.manual_seed(0)  # noqa: TID251 - two modules that start alike
        module = PathGanModule(config, given.samples(), 0, TWO_LINK.space, guides)
        run(module, 60)
        batch = module.samples.draw(200, module.rng)
        with torch.no_grad():
            condition = Condition(batch.mu, batch.start, batch.goal)
            points = module.net(condition, module.normal(200, module.net.noise_dim))
        found[name] = torch.cos(points[:, 0] - 1.0).mean().item()
    assert found["guided"] > found["alone"] + 0.3


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
    module = make_path_module("wgan", SMALL, arrays(), 0).eval()
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
