"""Auto-encoders of pictures: their losses, and that they learn."""

import math

import pytest
import torch

from tests.training.models.builders import run
from training.config import VaeConfig
from training.models.autoencoders import Decoder, Encoder, VaeModule, kl_divergence, reconstruction_loss
from training.models.checkpoint import seeded_initialisation


def test_the_losses_of_the_autoencoder_are_the_textbooks():
    assert reconstruction_loss(torch.zeros(1, 3, 2, 2), torch.ones(1, 3, 2, 2)).item() == 12.0
    assert kl_divergence(torch.zeros(1, 5), torch.zeros(1, 5)).item() == 0.0
    shifted = kl_divergence(torch.tensor([[2.0]]), torch.tensor([[math.log(0.25)]]))
    assert shifted.item() == pytest.approx(0.5 * (4.0 + 0.25 - math.log(0.25) - 1.0))


@pytest.mark.parametrize("patches", [1, 4])
def test_the_encoder_gives_a_mean_and_a_small_finite_log_variance(patches):
    mu, log_variance = Encoder((3, 48, 48), 7, 4, patches)(torch.rand(2, 3, 48, 48))
    assert mu.shape == log_variance.shape == (2, 7)
    assert (log_variance < -2.0).all()


def test_a_decoder_that_has_become_white_everywhere_still_learns():
    decoder = Decoder((3, 48, 48), 7, 4)
    with torch.no_grad():
        decoder.layers[-2].bias.fill_(40.0)
    (decoder(torch.randn(2, 7)) + 1.0).square().mean().backward()
    assert (decoder.layers[-2].bias.grad > 0.01).all()


def test_the_vae_learns_to_reconstruct():
    images = torch.full((16, 3, 48, 48), 255, dtype=torch.uint8)
    images[::2, 1:] = 0
    config = VaeConfig(latent_dim=4, width=4, steps=80, batch_size=8, learning_rate=5e-3)
    with seeded_initialisation(0):
        module = VaeModule(config, images, 0)
    first = run(module, 1).metrics()["reconstruction_loss"]
    assert run(module, 79).metrics()["reconstruction_loss"] < 0.2 * first
