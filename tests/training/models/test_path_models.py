"""Flow and WGAN-GP over points of paths: what they learn, and how their graphs answer."""

import numpy as np
import onnxruntime
import pytest
import torch

from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from tests.training.models.path_builders import LATENT, arrays
from training.config import PathTrainConfig
from training.models.lookups import make_lookups
from training.models.paths import Condition, PathGanModule, swept
from training.models.settings import FlowConfig, LookupConfig, PathGanConfig
from training.paths.bundling import PointSampler, point_graph
from training.trials.paths import make_path_module

NO_LOOKUPS = LookupConfig()
FEW = LookupConfig(points_per_link=3, side_m=0.0)
SMALL = PathTrainConfig(
    flow=FlowConfig(hidden=64, layers=2, steps=600, batch_size=256, place=True, lookups=NO_LOOKUPS),
    wgan=PathGanConfig(hidden=32, layers=2, critic_hidden=32, critic_layers=2, steps=40, batch_size=64),
)
ROWS = 64


def trained(name, steps=None, given=None, train=SMALL):
    module = make_path_module(name, train, given or arrays(count=1, scenarios=1), 0)
    first: dict[str, float] = {}
    for step in range(steps or getattr(train, name).steps):
        module.training_step(step, 0)
        first = first or module.metrics()
    return module.eval(), first


def blind(configurations):
    """No look-ups."""


def places_along(module, given, count=ROWS):
    """Answers and true points at places along the only path."""
    path = torch.tensor(given.paths[0])
    condition = Condition(
        torch.zeros(count, LATENT),
        path[:1].expand(count, 2),
        path[-1:].expand(count, 2),
        torch.linspace(0.0, 1.0, count).unsqueeze(1),
    )
    noise = torch.rand(count, module.net.noise_dim, generator=torch.Generator().manual_seed(3))
    with torch.no_grad():
        found = module.net(condition, (2.0 * noise - 1.0) * torch.pi, blind).numpy().astype(np.float64)
    space = TWO_LINK.space
    wanted = given.paths[0][0] + np.linspace(0, 1, count)[:, None] * space.difference(
        given.paths[0][0], given.paths[0][-1]
    )
    return np.linalg.norm(space.difference(wanted, found), axis=1)


@pytest.mark.slow
def test_a_flow_that_is_asked_for_a_place_learns_the_only_path_there_is():
    given = arrays(count=1, scenarios=1)
    module, _ = trained("flow", given=given)
    # Uniform draws would be 2.4 rad away; six seeds gave 0.12 to 0.16.
    assert np.median(places_along(module, given)) < 0.5


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
        module = PathGanModule(config, given.samples(), None, 0, TWO_LINK.space, guides)
        for step in range(60):
            module.training_step(step, 0)
        batch = module.samples.draw(200, module.rng)
        with torch.no_grad():
            points = module.net(module.condition(batch), module.normal(200, module.net.noise_dim), blind)
        found[name] = torch.cos(points[:, 0] - 1.0).mean().item()
    assert found["guided"] > found["alone"] + 0.3


def feeds(names, rows=5, dim=2):
    rng = np.random.default_rng(1)
    shapes = {
        "latent": (rows, LATENT), "start": (rows, dim), "goal": (rows, dim), "place": (rows, 1),
        "noise": (rows, names.get("noise", 1)), "jitter": (rows, 2), "image": (1, 3, 48, 48),
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


@pytest.mark.parametrize(("name", "looks"), [("flow", True), ("wgan", False)])
@pytest.mark.slow
def test_a_graph_answers_as_the_network_does(name, looks):
    config = getattr(SMALL, name).model_copy(update={"lookups": FEW if looks else NO_LOOKUPS})
    module = make_path_module(name, SMALL.model_copy(update={name: config}), arrays(), 0).eval()
    lookups = make_lookups(config.lookups, PlanarWorld(TWO_LINK, Camera()))
    graph = point_graph(PointSampler(module.net, lookups, place=config.place, sweep=4), LATENT, 48)
    assert graph.looks_at_picture == looks
    names = {item.name: item.shape[0] for item in graph.random_inputs}
    extra = ["image"] if graph.looks_at_picture else []
    fed = feeds(names | dict.fromkeys(["latent", "start", "goal", *extra], 0))
    tensors = {key: torch.tensor(value) for key, value in fed.items()}
    place = swept(tensors["place"], 4) if config.place else None
    with torch.no_grad():
        condition = Condition(tensors["latent"], tensors["start"], tensors["goal"], place)
        wanted = module.net(
            condition,
            tensors["noise"],
            blind if lookups is None else lambda at: lookups(tensors["image"], at.unsqueeze(0)).squeeze(0),
        )
    np.testing.assert_allclose(answer(graph.model, fed)[:, 0], wanted, atol=1e-4)
    one = {key: value if key == "image" else value[:1] for key, value in fed.items()}
    assert answer(graph.model, one).shape == (1, 1, 2)
