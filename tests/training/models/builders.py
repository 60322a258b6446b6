"""Small modules for the tests of training."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import lightning
import torch

from cspace.space import circles
from training.config import VaeConfig
from training.models.checkpoint import fit_module, seeded_initialisation
from training.models.data import ScenarioSamples
from training.models.families.joint import JointGanConfig, JointModule
from training.models.families.wgan_gp import GanConfig, WganGpModule

TINY = {
    "hidden": 16,
    "layers": 2,
    "critic_hidden": 16,
    "critic_layers": 2,
    "batch_size": 32,
    "critic_steps": 2,
}
SCALE, SPACE = (torch.zeros(2), torch.ones(2)), circles(2)


def ring_samples(scenarios: int = 2, latent_dim: int = 3) -> ScenarioSamples:
    """Configurations near one point a scenario, so that the condition matters."""
    rng = torch.Generator().manual_seed(1)
    ids = torch.arange(400) % scenarios
    centres = torch.linspace(-2.0, 2.0, scenarios)[ids]
    configurations = torch.stack([centres, -centres], dim=1) + 0.2 * torch.randn(400, 2, generator=rng)
    mu = torch.eye(max(scenarios, latent_dim))[:scenarios, :latent_dim]
    return ScenarioSamples(configurations, ids, mu, torch.full_like(mu, 0.05))


def tiny_module(seed: int = 0, **changes: object) -> WganGpModule:
    """A WGAN-GP that trains in milliseconds a step."""
    config = GanConfig.model_validate(TINY | {"steps": 20} | changes)
    with seeded_initialisation(seed):
        return WganGpModule(config, ring_samples(), SCALE, seed, SPACE)


def tiny_joint_module(seed: int = 0, **changes: object) -> JointModule:
    """A WGAN-GP that trains its encoder, too; two scenarios with a picture each."""
    small = {"critic_condition": "projection", "generator": "means", "steps": 20}
    config = JointGanConfig.model_validate(TINY | small | changes)
    vae = VaeConfig(latent_dim=3, width=4, batch_size=2)
    images = torch.zeros(2, 3, 48, 48, dtype=torch.uint8)
    images[1, :, 12:36] = 255
    with seeded_initialisation(seed):
        return JointModule(config, ring_samples(), SCALE, seed, SPACE, vae=vae, images=images)


def run(module: lightning.LightningModule, steps: int, last: Path | None = None) -> torch.nn.Module:
    """Take training steps, or those that a checkpoint's module has left."""
    fit_module(module, steps, last)
    return module


def save(path: Path, module: torch.nn.Module, history: Sequence[Mapping[str, float]] = ()) -> Path:
    """A checkpoint of a module that was not trained."""
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save({"state_dict": module.state_dict(), "history": list(history)}, path)
    return path


def weights(module: torch.nn.Module) -> torch.Tensor:
    """All parameters in one row."""
    return torch.cat([parameter.detach().flatten() for parameter in module.parameters()])
