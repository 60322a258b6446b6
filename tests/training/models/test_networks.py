import math

import pytest
import torch

from cspace.space import circles
from training.models.autoencoders import Decoder, Encoder
from training.models.families.wgan_gp import Critic, MeansGenerator, Sizes, TorusGenerator

SCALE = (torch.zeros(3), torch.ones(3))
SIZES = Sizes(circles(3), 5, 16, 2)


@pytest.mark.parametrize("patches", [1, 4])
def test_the_encoder_gives_a_mean_and_a_small_finite_log_variance(patches):
    mu, log_variance = Encoder(48, 7, 4, patches)(torch.rand(2, 3, 48, 48))
    assert mu.shape == log_variance.shape == (2, 7)
    assert (log_variance < -2.0).all()


def test_a_decoder_that_has_become_white_everywhere_still_learns():
    decoder = Decoder(48, 7, 4)
    with torch.no_grad():
        decoder.layers[-2].bias.fill_(40.0)
    (decoder(torch.randn(2, 7)) + 1.0).square().mean().backward()
    assert (decoder.layers[-2].bias.grad > 0.01).all()


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


@pytest.mark.parametrize("features", ["torus", "standardised"])
def test_the_critic_by_projection_tells_scenarios_apart(features):
    critic = Critic(SIZES, scenarios=2, features=features, scale=SCALE)
    same = torch.zeros(2, 3)
    values = critic(same, torch.tensor([0, 1]))
    assert values.shape == (2,)
    assert values[0] != values[1]


def test_the_critic_by_latent_tells_latents_apart():
    critic = Critic(SIZES, scenarios=None, features="torus", scale=SCALE)
    values = critic(torch.zeros(2, 3), torch.stack([torch.zeros(5), torch.ones(5)]))
    assert values[0] != values[1]
