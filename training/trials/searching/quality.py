"""A sampler under training, measured on validation scenarios without leaving torch."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from cspace.splits import Split
from cspace.world import World
from services.evaluator.measures.reconstruction import SampleQuality
from services.evaluator.measures.scenes import Scene, Stage
from training.models.cells import UniformBase
from training.models.mixture import GatedSampler, LookupSampler
from training.models.networks import TorusGenerator

SAMPLES = 1000

TorchSampler = GatedSampler | LookupSampler | TorusGenerator


@dataclass(frozen=True)
class Validation:
    """Validation scenarios with their truth, drawn once.

    Args:
        encoder: of the pictures.
        scenes: the scenarios.
        held_out: free configurations of each, (n, d) rad.
        uniform_energy: summed energy distance of uniform samples.
    """

    encoder: nn.Module
    scenes: Sequence[Scene]
    held_out: Sequence[NDArray[np.float64]]
    uniform_energy: float

    @classmethod
    def draw(cls, encoder: nn.Module, world: World, scenarios: int) -> "Validation":
        """The first scenarios of the validation split."""
        stage = Stage(world, Split.VALIDATION, 0)
        scenes = [Scene(stage, index) for index in range(scenarios)]
        held_out = [scene.free(SAMPLES, scene.rng(0)) for scene in scenes]
        stood = cls(encoder.eval(), scenes, held_out, 1.0)
        return replace(stood, uniform_energy=float(sum(row.energy for row in stood.rows(None))))

    def rows(self, sampler: TorchSampler | None) -> list[SampleQuality]:
        """A sampler in every scenario; uniform samples for None."""
        return [
            scene.quality(self._sample(sampler, scene), real)
            for scene, real in zip(self.scenes, self.held_out, strict=True)
        ]

    def measure(self, sampler: TorchSampler) -> dict[str, float]:
        """Means of precision and coverage, and the energy ratio, as ``validation_*``."""
        rows = self.rows(sampler)
        return {
            "validation_precision": float(np.mean([row.precision for row in rows])),
            "validation_coverage": float(np.mean([row.coverage for row in rows])),
            "validation_edr": float(np.sum([row.energy for row in rows])) / self.uniform_energy,
        }

    def _sample(self, sampler: TorchSampler | None, scene: Scene) -> NDArray[np.float64]:
        if sampler is None:
            return scene.space.sample_uniform(scene.rng(1), SAMPLES)
        rng = torch.Generator().manual_seed(scene.sampler_seed())
        image = torch.from_numpy(scene.stage.world.sensor.to_network(scene.image[None]))
        dim = scene.space.dim
        with torch.inference_mode():
            mu, log_variance = self.encoder(image)
            latent = mu + (log_variance / 2.0).exp() * torch.randn(SAMPLES, mu.shape[1], generator=rng)
            if isinstance(sampler, GatedSampler):
                cell, place, jitter = (torch.rand(SAMPLES, size, generator=rng) for size in (1, 1, dim))
                start = [cell, place, jitter - 0.5]
            else:
                start = [UniformBase(scene.space).draw(torch.zeros(SAMPLES), rng)]
            noise = torch.randn(SAMPLES, sampler.noise_dim, generator=rng)
            seen = [image] if getattr(sampler, "lookups", None) is not None else []
            samples: torch.Tensor = sampler(latent, *start, noise, *seen)
        return scene.space.to_float32(samples.squeeze(1).numpy()).astype(np.float64)
