"""Sizes, losses and budgets of the path models."""

from typing import Literal

from pydantic import Field

from training.models.settings import LookupConfig
from training.section import Section


class DensityConfig(Section):
    """A U-Net over the validity head's map with start and goal, which tells where the path runs."""

    cells: int = Field(48, ge=8, multiple_of=8, description="of the map along each joint")
    ways: bool = Field(
        default=True, description="whether it also sees how far about a way through each cell would lead"
    )
    penalty: float = Field(20.0, ge=0, description="what a rad costs more in collision, for the ways")
    width: int = Field(32, ge=1, description="channels at half the map's resolution")
    jitter_rad: float = Field(0.06, ge=0, description="standard deviation of the samples about the path")
    sharpness: float = Field(1.0, gt=0, description="power of the density that is drawn from")
    batch_size: int = Field(24, ge=1)
    steps: int = Field(1500, ge=1)
    learning_rate: float = Field(3e-3, gt=0)


class PointConfig(Section):
    """What all models have that give one point a row of random numbers."""

    hidden: int = Field(256, ge=1)
    layers: int = Field(3, ge=1)
    place: bool = Field(default=False, description="whether a sample is asked for at a place along the path")
    lookups: LookupConfig = LookupConfig()
    jitter_rad: float = Field(0.0, ge=0, description="standard deviation that is added to the samples")
    batch_size: int = Field(512, ge=2)
    steps: int = Field(4000, ge=1)
    learning_rate: float = Field(2e-3, gt=0)


class FlowConfig(PointConfig):
    """Flow matching on the torus (Lipman et al. 2023; Chen and Lipman 2024)."""

    place: bool = False
    lookups: LookupConfig = LookupConfig(points_per_link=8, side_m=0.1, groups=32)
    jitter_rad: float = Field(0.05, ge=0)
    hidden: int = Field(384, ge=1)
    batch_size: int = Field(1024, ge=2)
    steps: int = Field(10_000, ge=1)
    evaluations: int = Field(8, ge=1, description="of the velocity for each sample")


class DistillationConfig(Section):
    """A student that answers as the flow does, by fewer evaluations; in all else it is a copy of the flow."""

    evaluations: int = Field(1, ge=1, description="of the student's network for each sample")
    batch_size: int = Field(512, ge=2)
    steps: int = Field(3000, ge=1)
    learning_rate: float = Field(1e-3, gt=0)

    def student_of(self, flow: FlowConfig) -> FlowConfig:
        """The student's network, from its teacher's."""
        return flow.model_copy(update={"evaluations": self.evaluations})


class PathVaeConfig(PointConfig):
    """A conditional VAE (Ichter, Harrison, Pavone 2018)."""

    code_dim: int = Field(3, ge=1)
    kl_weight: float = Field(0.02, ge=0)


class PathGanConfig(PointConfig):
    """A WGAN-GP whose condition is latent, start and goal (MultiWGAN-GP paper, section 4)."""

    refinements: int = Field(
        0, ge=0, description="0: an embedding of the point in one go, as in the paper; else steps from a base"
    )
    noise_dim: int = Field(2, ge=1)
    critic_hidden: int = Field(256, ge=1)
    critic_layers: int = Field(3, ge=2)
    penalty: Literal["one_sided", "two_sided"] = "one_sided"
    penalty_weight: float = Field(10.0, ge=0)
    critic_steps: int = Field(4, ge=1)
    critic_learning_rate: float = Field(2e-3, gt=0)
    betas: tuple[float, float] = (0.0, 0.9)
    guide_weight: float = Field(0.0, ge=0, description="of the configuration space's local critics")
    steps: int = Field(1500, ge=1)
    learning_rate: float = Field(1e-3, gt=0)
