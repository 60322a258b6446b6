"""Distillation: one generator learns to answer as a mixture does, so that serving costs one."""

import torch
from torch.optim.lr_scheduler import LambdaLR

from training.models.cells import CellBase
from training.models.data import ScenarioSamples
from training.models.lookups.lookups import Reader, read
from training.models.mixture import Experts
from training.models.modules import TrialModule
from training.models.networks import TorusGenerator
from training.models.settings import GanConfig


class DistillationModule(TrialModule):
    """Regression on the mixture's answers: the cells part the torus, so that they are a function of the base.

    Args:
        config: the student's budget.
        samples: latents of the scenarios.
        teacher: the mixture's generators, frozen.
        teacher_reader: of the teacher's look-ups; None without.
        student: a fresh generator.
        reader: of the student's look-ups; None without.
        base: the cells, drawn as the gate says.
        seed: of every draw.
    """

    samples: ScenarioSamples

    def __init__(
        self,
        config: GanConfig,
        samples: ScenarioSamples,
        teacher: Experts,
        teacher_reader: Reader | None,
        student: TorusGenerator,
        reader: Reader | None,
        base: CellBase,
        seed: int,
    ) -> None:
        super().__init__(seed)
        self.config, self.samples, self.base = config, samples, base
        self.teacher = teacher.requires_grad_(requires_grad=False)
        self.teacher_reader, self.reader, self.generator = teacher_reader, reader, student
        optimiser = torch.optim.Adam(self.generator.parameters(), lr=config.generator_learning_rate)
        self.training_optimisers = [optimiser]
        self.training_schedules = [
            LambdaLR(optimiser, lambda step: 1.0 - 0.95 * min(1.0, step / config.steps))
        ]

    def training_step(self, step: int, batch_index: int) -> None:
        """One step of how far the answers are apart, summed over the joints."""
        del step, batch_index
        mu, size = self.samples.mu, self.config.batch_size
        ids = torch.randint(len(mu), (size,), generator=self.rng, device=self.device)
        latent = mu[ids] + self.samples.sigma[ids] * self.normal(size, mu.shape[1])
        cell, base = self.base.draw_in_cells(ids, self.rng)
        noise = self.normal(size, self.config.noise_dim)
        with torch.no_grad():
            wanted = self.teacher(latent, base, noise, read(self.teacher_reader, ids, base), cell)
        answer = self.generator(latent, base, noise, read(self.reader, ids, base)).squeeze(1)
        loss = self.generator.joints.apart(answer, wanted).sum(dim=1).mean()
        self.descend(loss)
        self.latest = {"distillation_loss": loss.detach()}
