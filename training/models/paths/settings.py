"""Sizes, losses and budgets of the path models."""

from typing import Literal

from pydantic import Field

from training.models.settings import LookupConfig
from training.section import Section


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


class PathGanConfig(PointConfig):
    """A WGAN-GP whose condition is latent, start and goal (MultiWGAN-GP paper, section 4)."""

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
