"""A flow distilled: a student that answers a row of noise as the flow does, by fewer evaluations."""

from collections.abc import Mapping

import torch
from torch import Tensor

from cspace.space import JointSpace
from training.models.lookups.lookups import Scenes
from training.models.paths.modules import PointModule
from training.models.paths.points import PathFlow
from training.models.paths.samples import PathSamples
from training.models.paths.settings import DistillationConfig, FlowConfig

# Where the loss turns from squares to distances, rad. Distances let the student take a side where the flow
# parts; squares would send it between both.
_ROUND_RAD = 0.05


class FlowDistillationModule(PointModule):
    """Regression on the ends of the flow's ways (knowledge distillation, Luhman and Luhman 2021).

    The flow's way from a row of noise to its end is a function of the noise, so that pairs of both are data.
    The loss is the pseudo-Huber distance (Song and Dhariwal 2024) of the ends, before they are wrapped.

    Args:
        config: the student's budget.
        flow: the teacher's configuration.
        samples: the paths, whose starts, goals and pictures are asked for.
        scenes: their pictures; None where nothing is looked up.
        weights: of the trained flow, which is the teacher; the student starts as a copy.
        seed: of every draw.
        space: the joint space.
    """

    def __init__(
        self,
        config: DistillationConfig,
        flow: FlowConfig,
        samples: PathSamples,
        scenes: Scenes | None,
        weights: Mapping[str, Tensor],
        seed: int,
        space: JointSpace,
    ) -> None:
        super().__init__(flow, samples, scenes, seed, space)
        self.config = config
        self.teacher = PathFlow(self.sizes, flow.evaluations, place=flow.place)
        self.teacher.load_state_dict(weights)
        self.teacher.requires_grad_(requires_grad=False)
        self.net = PathFlow(self.sizes, config.evaluations, place=flow.place)
        self.net.load_state_dict(weights)
        self.one_cycle(self.net.parameters(), config.learning_rate, config.steps)

    def training_step(self, step: int, batch_index: int) -> None:
        """One step of the regression."""
        del step, batch_index
        batch = self.samples.draw(self.config.batch_size, self.rng)
        condition, look = self.condition(batch), self.look(batch)
        noise = (2.0 * self.uniform(*batch.points.shape) - 1.0) * torch.pi
        with torch.no_grad():
            wanted = self.teacher(condition, noise, look)
        squared = (self.net(condition, noise, look) - wanted).square().sum(dim=1)
        loss = ((squared + _ROUND_RAD**2).sqrt() - _ROUND_RAD).mean()
        self.descend(loss)
        self.latest = {"distillation_loss": loss.detach()}
