import pytest
import torch
from pydantic import ValidationError

from tests.training.models.builders import SCALE, SPACE, TINY, ring_samples, run, tiny_module, weights
from training.config import VaeConfig
from training.models.autoencoders import VaeModule
from training.models.checkpoint import seeded_initialisation
from training.models.families.guided import GlobalConfig, GuidedModule
from training.models.families.wgan_gp import GanConfig


def test_the_same_seed_trains_to_the_same_weights_and_another_to_others():
    first, again, other = (weights(run(tiny_module(seed=seed), 4)) for seed in (3, 3, 4))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_training_leaves_the_global_generator_alone():
    before = torch.random.get_rng_state()
    run(tiny_module(), 2)
    assert torch.equal(before, torch.random.get_rng_state())


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


@pytest.mark.parametrize(
    "changes",
    [
        {"penalty": "two_sided"},
        {"critic_condition": "projection"},
        {
            "generator": "means",
            "means": 4,
            "sigma": 0.025,
            "smooth_maximum": 0.1,
            "critic_features": "standardised",
        },
    ],
)
def test_every_part_of_the_paper_is_a_switch_that_trains(changes):
    module = run(tiny_module(**changes), 3)
    assert all(torch.isfinite(torch.tensor(value)) for value in module.metrics().values())
    assert set(module.metrics()) == {
        "critic_loss",
        "wasserstein_estimate",
        "gradient_penalty",
        "generator_loss",
    }


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


def test_means_belong_to_the_means_generator():
    with pytest.raises(ValidationError, match="means"):
        GanConfig(generator="torus", means=4)


def test_the_vae_learns_to_reconstruct():
    images = torch.full((16, 3, 48, 48), 255, dtype=torch.uint8)
    images[::2, 1:] = 0
    config = VaeConfig(latent_dim=4, width=4, steps=80, batch_size=8, learning_rate=5e-3)
    with seeded_initialisation(0):
        module = VaeModule(config, images, 0)
    first = run(module, 1).metrics()["reconstruction_loss"]
    assert run(module, 79).metrics()["reconstruction_loss"] < 0.2 * first
