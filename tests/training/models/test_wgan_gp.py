"""WGAN-GPs, guided or not: losses, generators and critics, and what training does to them."""

import math

import pytest
import torch

from cspace.space import circles
from tests.training.models.builders import SCALE, SPACE, TINY, ring_samples, run, tiny_module, weights
from training.models.checkpoint import seeded_initialisation
from training.models.families import wgan_gp
from training.models.families.guided import GlobalConfig, GuidedModule
from training.models.families.wgan_gp import Critic, MeansGenerator, Sizes, TorusGenerator

SCALE_3 = (torch.zeros(3), torch.ones(3))
SIZES = Sizes(circles(3), 5, 16, 2)


def test_a_linear_critic_of_slope_one_pays_no_penalty_and_of_slope_three_pays_four():
    points = torch.randn(8, 2, generator=torch.Generator().manual_seed(0))
    slope_one = wgan_gp.gradient_penalty(lambda x: x[:, 0], points, one_sided=False)
    slope_three = wgan_gp.gradient_penalty(lambda x: 3.0 * x[:, 0], points, one_sided=False)
    assert slope_one.item() == pytest.approx(0.0, abs=1e-6)
    assert slope_three.item() == pytest.approx(4.0, rel=1e-5)


def test_the_penalty_reaches_the_critics_weights():
    slope = torch.tensor(3.0, requires_grad=True)
    wgan_gp.gradient_penalty(lambda x: slope * x[:, 0], torch.ones(4, 2), one_sided=True).backward()
    assert slope.grad is not None
    assert slope.grad.item() == pytest.approx(2.0 * (3.0 - 1.0), rel=1e-5)


def test_standardised_angles_are_interpolated_on_the_straight_line():
    real, fake = torch.full((8, 2), 3.0), torch.full((8, 1, 2), -3.0)
    between = tiny_module(critic_features="standardised").interpolate(real, fake)
    assert (between.abs() <= 3.0).all()
    assert (between[:, 0].abs() < 2.0).any()


@pytest.mark.parametrize(("first", "second"), [(1.0, 4.0), (-2.0, -7.0), (3.0, 3.0)])
def test_the_smooth_maximum_tends_to_the_maximum(first, second):
    value = wgan_gp.smooth_maximum(torch.tensor([first, second]), 1e-4)
    assert value.item() == pytest.approx(max(first, second), abs=1e-3)
    # Half an epsilon above equal values.
    equal = torch.tensor([first, first])
    assert wgan_gp.smooth_maximum(equal, 0.1).item() == pytest.approx(first + 0.05)


def test_the_fake_term_shifts_with_a_constant_added_to_the_critic():
    values = torch.tensor([[0.0, 1.0, -2.0, 0.5]])
    shift = wgan_gp.fake_term(values + 7.0, 0.1) - wgan_gp.fake_term(values, 0.1)
    assert shift.item() == pytest.approx(7.0, rel=1e-6)


def test_the_torus_generator_starts_near_the_uniform_sampler():
    base = torch.rand(64, 3) * 2.0 * torch.pi - torch.pi
    samples = TorusGenerator(SIZES, 2)(torch.zeros(64, 5), base, torch.randn(64, 2))
    assert samples.shape == (64, 1, 3)
    assert (samples[:, 0] - base).abs().max() < 0.3


def test_the_torus_generator_does_not_see_the_seam():
    generator = TorusGenerator(Sizes(circles(2), 5, 16, 2), 2)
    latent, noise = torch.randn(4, 5), torch.randn(4, 2)
    near = torch.full((4, 2), math.pi)
    apart = generator(latent, near, noise) - generator(latent, -near, noise)
    assert torch.allclose(apart, torch.full_like(apart, 2.0 * math.pi), atol=1e-5)


def test_the_means_generator_spreads_its_samples_by_sigma_round_each_mean():
    generator = MeansGenerator(SIZES, 4, 0.5, (torch.zeros(3), torch.full((3,), 2.0)))
    latent = torch.zeros(1, 5)
    quiet, loud = generator(latent, torch.zeros(1, 4, 3)), generator(latent, torch.ones(1, 4, 3))
    assert quiet.shape == (1, 4, 3)
    assert torch.allclose(loud - quiet, torch.full_like(quiet, 0.5 * 2.0), atol=1e-6)


@pytest.mark.parametrize(
    ("scenarios", "features", "condition"),
    [
        (2, "torus", torch.tensor([0, 1])),
        (2, "standardised", torch.tensor([0, 1])),
        (None, "torus", torch.stack([torch.zeros(5), torch.ones(5)])),
    ],
)
def test_the_critic_tells_scenarios_apart(scenarios, features, condition):
    values = Critic(SIZES, scenarios=scenarios, features=features, scale=SCALE_3)(
        torch.zeros(2, 3), condition
    )
    assert values.shape == (2,)
    assert values[0] != values[1]


@pytest.mark.slow
def test_training_moves_samples_towards_the_data():
    def distance(module):
        batch = ring_samples().draw(256, torch.Generator().manual_seed(5))
        with torch.no_grad():
            wide = module.generate(batch)[:, 0] - batch.configurations
        return (torch.remainder(wide + torch.pi, 2 * torch.pi) - torch.pi).norm(dim=1).mean().item()

    rates = {"generator_learning_rate": 5e-3, "critic_learning_rate": 1e-2}
    module = tiny_module(steps=250, hidden=32, critic_hidden=32, critic_steps=4, **rates)
    before = distance(module)
    assert distance(run(module, 250)) < 0.6 * before


def test_local_critics_are_frozen_and_change_the_generators_way():
    guide = run(tiny_module(seed=9), 30).critic
    plain = run(tiny_module(), 3)
    config = GlobalConfig.model_validate(TINY | {"steps": 20, "local_critic_weight": 1.0})
    with seeded_initialisation(0):
        guided = GuidedModule(config, ring_samples(), SCALE, 0, SPACE, critics=[guide])
    before = weights(guide)
    run(guided, 3)
    assert torch.equal(before, weights(guide))
    assert not torch.equal(weights(plain.generator), weights(guided.generator))
