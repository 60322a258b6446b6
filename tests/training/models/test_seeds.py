"""Seeds reproduce: a few steps of every module end at the numbers that are written here."""

import numpy as np
import pytest
import torch

from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from tests.training.models.builders import (
    SCALE,
    SPACE,
    TINY,
    ring_samples,
    run,
    tiny_joint_module,
    tiny_module,
    weights,
)
from tests.training.models.path_builders import samples
from training.config import PathGanConfig, VaeConfig
from training.models.autoencoders import VaeModule
from training.models.checkpoint import seeded_initialisation
from training.models.data import Cells
from training.models.families.guided import GlobalConfig, GuidedModule
from training.models.families.mixture import CellBase, GateConfig, GateModule
from training.models.families.wgan_gp import GanConfig, WganGpModule
from training.models.lookups import LookupConfig, Scenes, make_reader
from training.models.paths import PathGanModule

SEED, STEPS = 3, {"steps": 20}
IMAGES = torch.zeros(2, 48, 48, 3, dtype=torch.uint8)
IMAGES[1, 12:36] = 255
PAPER = {
    "generator": "means",
    "means": 4,
    "sigma": 0.025,
    "smooth_maximum": 0.1,
    "penalty": "two_sided",
    "critic_features": "standardised",
    "critic_condition": "projection",
}


def guided():
    critics = [run(tiny_module(seed=9), 5).critic for _ in range(2)]
    config = GlobalConfig.model_validate(TINY | STEPS | {"local_critic_weight": 0.5})
    with seeded_initialisation(SEED):
        return GuidedModule(config, ring_samples(), SCALE, SEED, SPACE, critics=critics)


def mixture():
    points = [[[-2.0, -2.0], [-2.0, -1.0]], [[1.0, 1.0], [1.0, 2.0]], [[2.5, -2.5], [2.5, -1.5]]]
    spacing, none = np.array([0.5, 0.25, 0.1], np.float32), np.zeros(0, np.int64)
    cells = Cells(np.array(points, np.float32), spacing, none, none)
    look = LookupConfig(points_per_link=3, side_m=0.1)
    config = GanConfig.model_validate(TINY | STEPS)
    with seeded_initialisation(SEED):
        base = CellBase(cells, torch.tensor([[0.2, 0.5, 0.3], [0.5, 0.1, 0.4]]), SPACE)
        scenes = Scenes(PlanarWorld(TWO_LINK, Camera()), IMAGES)
        readers = make_reader(look, scenes), make_reader(look, scenes)
        return WganGpModule(config, ring_samples(), SCALE, SEED, SPACE, base, readers)


def gate():
    mu, shares = torch.eye(2, 4), torch.tensor([[0.9, 0.1, 0.0], [0.1, 0.2, 0.7]])
    config = GateConfig(cells=3, hidden=16, batch_size=16, **STEPS)
    with seeded_initialisation(SEED):
        return GateModule(config, mu, torch.full_like(mu, 0.05), shares, SEED)


def vae():
    with seeded_initialisation(SEED):
        config = VaeConfig(latent_dim=4, width=4, batch_size=8, **STEPS)
        return VaeModule(config, IMAGES.permute(0, 3, 1, 2).contiguous(), SEED)


def path():
    config = PathGanConfig(hidden=32, layers=2, critic_hidden=32, critic_layers=2, steps=40, batch_size=64)
    with seeded_initialisation(SEED):
        return PathGanModule(config, samples(), SEED, TWO_LINK.space)


@pytest.mark.parametrize(
    ("make", "steps", "metrics", "total"),
    [
        (lambda: tiny_module(SEED), 5, {"critic_loss": -0.16721, "generator_loss": -0.13532}, 142.1694),
        # One step: Adam's first goes by signs of gradients, and those of tiny ones hang on the processor.
        (lambda: tiny_module(SEED, **PAPER), 1, {"critic_loss": 1.76769, "gradient_penalty": 0.25612}, None),
        (lambda: tiny_joint_module(SEED), 3, {"critic_loss": 0.3643, "kl": 3.09955}, 1039.3887),
        (guided, 5, {"critic_loss": -0.16716, "generator_loss": -0.23905}, 288.8506),
        (mixture, 5, {"critic_loss": -0.11281, "generator_loss": 0.00829}, 206.3653),
        (gate, 5, {"gate_loss": 1.09382, "gate_divergence": 0.61976}, 57.1108),
        (vae, 5, {"reconstruction_loss": 6752.75244, "kl": 3.94654}, 969.2781),
        (path, 5, {"wasserstein_estimate": 0.64213, "generator_loss": 0.55727}, 404.5731),
    ],
    ids=["wgan_gp", "means", "joint", "guided", "mixture", "gate", "vae", "path"],
)
def test_a_few_steps_end_at_the_same_numbers_as_ever(make, steps, metrics, total):
    module = run(make(), steps)
    found = module.metrics()
    assert {name: found[name] for name in metrics} == pytest.approx(metrics, rel=1e-3, abs=1e-4)
    assert total is None or weights(module).abs().sum().item() == pytest.approx(total, rel=1e-5)
