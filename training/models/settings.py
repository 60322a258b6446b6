"""Sizes, losses and budgets of all models: what configurations are made of."""

from typing import Literal

from pydantic import Field, model_validator

from training.section import Section


class VaeConfig(Section):
    """The picture's variational auto-encoder."""

    latent_dim: int = Field(64, ge=1)
    width: int = Field(16, ge=1, description="channels of the first convolution")
    patches: Literal[1, 4] = 4
    steps: int = Field(400, ge=1)
    batch_size: int = Field(64, ge=2)
    learning_rate: float = Field(2e-3, gt=0)
    kl_weight: float = Field(1.0, ge=0)
    kl_warmup: float = Field(0.3, ge=0, le=1, description="share of the steps over which the KL term grows")
    gradient_clip: float = Field(200.0, gt=0)


class GateConfig(Section):
    """The gate: which cell of the configuration space a picture's free configurations lie in."""

    cells: int = Field(0, ge=0, description="0 for none: the generators start from the whole torus")
    points: int = Field(1024, ge=1, description="stored in each cell, from which the generators start")
    steps: int = Field(600, ge=1)
    batch_size: int = Field(128, ge=1)
    hidden: int = Field(128, ge=1)
    layers: int = Field(2, ge=1)
    learning_rate: float = Field(4e-3, gt=0)


class LookupConfig(Section):
    """Where a network reads a picture of a plane: along the links and beside them."""

    points_per_link: int = Field(0, ge=0, description="0 for no look-ups")
    side_m: float = Field(0.0, ge=0, description="distance of the rows beside each link; 0 for none")

    @model_validator(mode="after")
    def _one_point_is_no_row(self) -> "LookupConfig":
        if self.points_per_link == 1:
            raise ValueError("points_per_link counts both ends of a link: 2 or more, or 0 for no look-ups")
        return self


class GanConfig(Section):
    """One WGAN-GP: generator, critic, losses and budget."""

    generator: Literal["torus", "means"] = "torus"
    hidden: int = Field(128, ge=1)
    layers: int = Field(3, ge=1)
    noise_dim: int = Field(2, ge=1, description="explicit noise of the torus generator")
    means: int = Field(1, ge=1, description="K of the means generator")
    sigma: float = Field(0.0, ge=0, description="standard deviation round each mean, on standardised angles")
    smooth_maximum: float | None = Field(
        None, gt=0, description="epsilon of the smooth maximum; none switches it off"
    )
    critic_condition: Literal["latent", "projection"] = "latent"
    critic_features: Literal["torus", "standardised"] = "torus"
    critic_hidden: int = Field(128, ge=1)
    critic_layers: int = Field(3, ge=2)
    generator_lookups: LookupConfig = LookupConfig()
    critic_lookups: LookupConfig = LookupConfig()
    penalty: Literal["one_sided", "two_sided"] = "one_sided"
    penalty_weight: float = Field(10.0, ge=0)
    critic_steps: int = Field(4, ge=1, description="critic steps before each generator step")
    generator_learning_rate: float = Field(1e-3, gt=0)
    critic_learning_rate: float = Field(2e-3, gt=0)
    betas: tuple[float, float] = (0.0, 0.9)
    decay_from: float = Field(0.4, ge=0, le=1, description="share of the steps after which the rates fall")
    batch_size: int = Field(512, ge=2)
    steps: int = Field(1000, ge=1, description="generator steps")

    @model_validator(mode="after")
    def _means_need_their_generator(self) -> "GanConfig":
        if self.generator == "torus" and (self.means != 1 or self.sigma != 0.0):
            raise ValueError(
                "means and sigma belong to generator=means; the torus generator takes means=1, sigma=0"
            )
        if self.generator == "means" and self.generator_lookups.points_per_link:
            raise ValueError("generator_lookups belong to generator=torus: the means have no base to look up")
        return self


class GlobalConfig(GanConfig):
    """The global WGAN-GP, guided by the local critics."""

    local_critic_weight: float = Field(0.1, ge=0, description="weight of the local critics' mean; 0 is off")
    encoder: Literal["trained", "joint"] = Field(
        "trained", description="trained before, or together with the generator: the paper's baseline"
    )
    reconstruction_weight: float = Field(
        1.0,
        ge=0,
        description="of the decoded pictures' error for a joint encoder; 0 leaves the KL term alone",
    )

    @model_validator(mode="after")
    def _joint_encoder_needs_its_critic(self) -> "GlobalConfig":
        if self.encoder == "joint" and self.critic_condition != "projection":
            raise ValueError("a joint encoder takes critic_condition=projection: latents change as it learns")
        return self


class GridConfig(Section):
    """What a head that reads arrays of space has beside the sizes of others."""

    groups: int = Field(
        64, ge=1, description="of the arm's spheres, base included, whose hazards are predicted"
    )
    finest: int = Field(
        0,
        ge=0,
        multiple_of=4,
        description="channels of features in voxels of 5 cm; 0: those of 10 cm are read",
    )
    width: int = Field(20, ge=4, multiple_of=4, description="channels of features in voxels of 10 cm")
    middle: int = Field(40, ge=4, multiple_of=4)
    deep: int = Field(64, ge=4, multiple_of=4)
    hazard_weight: float = Field(1.0, ge=0, description="of the groups' cross entropy, where truth is known")
    gradient_clip: float = Field(1.0, gt=0)


class ValidityConfig(Section):
    """The validity head: an occupancy network that reads the picture where the arm would be."""

    steps: int = Field(3000, ge=0, description="0 leaves the bundle without a head")
    pictures_per_step: int = Field(32, ge=1)
    configurations_per_picture: int = Field(64, ge=2)
    free_share: float = Field(
        gt=0, lt=1, description="of the joint space, on average: the prior that confidences are true to"
    )
    points_per_link: int = Field(12, ge=2)
    side_m: float = Field(0.1, ge=0, description="distance of the look-ups beside each link")
    grid: GridConfig | None = Field(
        None,
        exclude_if=lambda part: part is None,
        description="of a head that reads arrays of space at an arm's spheres; none: pictures along links",
    )
    hidden: int = Field(160, ge=1)
    layers: int = Field(2, ge=1)
    learning_rate: float = Field(4e-3, gt=0)


class PathGanConfig(Section):
    """A WGAN-GP whose condition is latent, start and goal (MultiWGAN-GP paper, section 4)."""

    hidden: int = Field(256, ge=1)
    layers: int = Field(3, ge=1)
    noise_dim: int = Field(2, ge=1)
    critic_hidden: int = Field(256, ge=1)
    critic_layers: int = Field(3, ge=2)
    penalty: Literal["one_sided", "two_sided"] = "one_sided"
    penalty_weight: float = Field(10.0, ge=0)
    critic_steps: int = Field(4, ge=1)
    critic_learning_rate: float = Field(2e-3, gt=0)
    betas: tuple[float, float] = (0.0, 0.9)
    batch_size: int = Field(512, ge=2)
    steps: int = Field(1500, ge=1)
    learning_rate: float = Field(1e-3, gt=0)


# The section of a job's configuration that a trial is trained by.
TrialSettings = VaeConfig | GateConfig | GanConfig | ValidityConfig | PathGanConfig
