import pytest
import torch

from tests.training.models.builders import run, tiny_joint_module
from training.models.autoencoders import kl_divergence


def encode(module):
    """What a training step does before its losses."""
    module._latents = module.encoder(module.images.float() / 127.5 - 1.0)


def gradients(loss, part):
    return torch.autograd.grad(loss, list(part.parameters()), retain_graph=True, allow_unused=True)


def test_each_loss_reaches_the_parts_that_it_trains_and_no_others():
    module = tiny_joint_module()
    encode(module)
    batch = module.samples.draw(32, module.rng)
    loss = module.critic_step_loss(batch)
    for part in (module.encoder, module.generator):
        assert all(gradient is None for gradient in gradients(loss, part))
    assert any(g.abs().sum() > 0 for g in gradients(loss, module.critic) if g is not None)
    loss = module.generator_step_loss(batch)
    assert all(gradient.abs().sum() > 0 for gradient in gradients(loss, module.decoder))


def test_the_generators_loss_alone_reaches_the_encoder():
    module = tiny_joint_module(reconstruction_weight=0.0)
    encode(module)
    loss = module.generator_step_loss(module.samples.draw(32, module.rng))
    loss = loss - kl_divergence(*module._latents).mean()
    assert all(gradient.abs().sum() > 0 for gradient in gradients(loss, module.encoder))
    assert all(gradient is None for gradient in gradients(loss, module.decoder))


@pytest.mark.slow
def test_training_reconstructs_the_pictures():
    rates = {"generator_learning_rate": 5e-3, "critic_learning_rate": 5e-3, "critic_steps": 1}
    module = run(tiny_joint_module(steps=120, **rates), 1)
    first = module.metrics()["reconstruction_loss"]
    assert run(module, 119).metrics()["reconstruction_loss"] < 0.2 * first
