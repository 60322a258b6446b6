"""Cells, gate and the mixture's graph."""

import numpy as np
import onnxruntime
import pytest
import torch

from cspace.space import circles
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from tests.training.models.builders import run
from training.models.checkpoint import seeded_initialisation
from training.models.data import Cells
from training.models.export import generator_graph
from training.models.families.mixture import (
    CellBase,
    Experts,
    Gate,
    GateConfig,
    GatedSampler,
    GateModule,
    gate_probabilities,
)
from training.models.families.wgan_gp import Sizes, TorusGenerator
from training.models.lookups import ArmLookups

SPACE = circles(2)
CELLS = Cells(
    np.array(
        [[[-2.0, -2.0], [-2.0, -1.0]], [[1.0, 1.0], [1.0, 2.0]], [[2.5, -2.5], [2.5, -1.5]]], np.float32
    ),
    np.array([0.5, 0.25, 0.1], np.float32),
    np.zeros(0, np.int64),
    np.array([0, 1, 1]),
)


def experts(count=2, looked_up=0):
    with seeded_initialisation(5):
        generators = [TorusGenerator(Sizes(SPACE, 4, 8, 2, looked_up), 2) for _ in range(count)]
    for generator in generators:
        torch.nn.init.normal_(generator.residual[-1].weight, generator=torch.Generator().manual_seed(count))
    return generators, Experts(generators, torch.tensor([0, 1, 1][: len(CELLS.points)]) % count)


def random_inputs(count, lookups):
    rng = torch.Generator().manual_seed(3)
    feeds = {
        "latent": torch.randn(count, 4, generator=rng),
        "cell": torch.rand(count, 1, generator=rng),
        "place": torch.rand(count, 1, generator=rng),
        "jitter": torch.rand(count, 2, generator=rng) - 0.5,
        "noise": torch.randn(count, 2, generator=rng),
    }
    return feeds | ({"image": torch.rand(1, 3, 48, 48, generator=rng) * 2 - 1} if lookups else {})


def answer(graph, feeds):
    session = onnxruntime.InferenceSession(graph, providers=["CPUExecutionProvider"])
    return session.run(None, {name: value.numpy() for name, value in feeds.items()})[0]


def test_a_base_in_cells_lies_round_the_points_of_the_cells_that_may_be_drawn():
    base = CellBase(CELLS, torch.tensor([[0.0, 1.0, 0.0], [0.5, 0.0, 0.5]]), SPACE)
    rng = torch.Generator().manual_seed(0)
    drawn = base.draw(torch.tensor([0] * 200 + [1] * 200), rng)
    # (400, cells): whether a sample lies round a point of each cell.
    gaps = (drawn[:, None, None] - torch.tensor(CELLS.points)).abs().amax(dim=3).amin(dim=2)
    inside = gaps <= torch.tensor(CELLS.spacing_rad) / 2
    assert inside[:200].int().tolist() == [[0, 1, 0]] * 200
    assert inside[200:].any(dim=0).tolist() == [True, False, True]
    assert bool((inside[200:].sum(dim=1) == 1).all())


def test_every_row_is_answered_by_the_generator_in_charge_of_its_cell():
    generators, mixture = experts()
    feeds, cell = random_inputs(6, lookups=False), torch.tensor([0, 1, 2, 2, 1, 0])
    base = torch.randn(6, 2, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        found = mixture(feeds["latent"], base, feeds["noise"], None, cell)
        own = [g(feeds["latent"], base, feeds["noise"])[:, 0] for g in generators]
    for row, index in enumerate([0, 1, 1, 1, 1, 0]):
        torch.testing.assert_close(found[row], own[index][row])


@pytest.mark.parametrize("lookups", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_the_mixtures_graph_answers_as_the_network(lookups):
    look = ArmLookups(PlanarWorld(TWO_LINK, Camera()), 3, 0.1) if lookups else None
    with seeded_initialisation(1):
        gate = Gate(4, 8, 2, 3)
    _, mixture = experts(looked_up=look.values if look else 0)
    sampler = GatedSampler(gate, CELLS, mixture, look)
    graph = generator_graph(sampler, 4, 48)
    for count in (1, 33):
        feeds = random_inputs(count, lookups)
        with torch.no_grad():
            expected = sampler(*feeds.values())
        found = answer(graph, feeds)
        assert found.shape == (count, 1, 2)
        np.testing.assert_allclose(found, expected.numpy(), atol=1e-5)


def test_the_gate_draws_cells_as_often_as_it_says():
    with seeded_initialisation(1):
        gate = Gate(4, 8, 2, 3)
    sampler = GatedSampler(gate, CELLS, experts(1)[1], None)
    for network in sampler.experts.networks:
        for part in network.parameters():
            torch.nn.init.zeros_(part)
    feeds = random_inputs(20_000, lookups=False)
    feeds["latent"] = feeds["latent"][:1].expand(20_000, 4).contiguous()
    with torch.no_grad():
        drawn = sampler(*feeds.values())[:, 0]
        wanted = torch.softmax(gate(feeds["latent"][:1]), dim=1)[0]
    share = torch.stack([(drawn[:, 0] < 0).float().mean(), (drawn[:, 0] > 2).float().mean()])
    torch.testing.assert_close(share, torch.stack([wanted[0], wanted[2]]), atol=0.02, rtol=0.0)


def test_the_gate_learns_the_shares_of_the_cells():
    shares = torch.tensor([[0.9, 0.1, 0.0], [0.1, 0.2, 0.7]])
    mu, config = torch.eye(2, 4), GateConfig(cells=3, hidden=16, steps=150, batch_size=16)
    with seeded_initialisation(0):
        module = GateModule(config, mu, torch.full_like(mu, 0.05), shares, 0)
    run(module, config.steps)
    np.testing.assert_allclose(gate_probabilities(module.gate, mu.numpy()), shares.numpy(), atol=0.05)
