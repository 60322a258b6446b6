"""Networks of the configuration space, fresh or from a trial's checkpoint."""

from pathlib import Path

from cspace.errors import JobError
from training.config import GanConfig, TrainConfig
from training.models.checkpoint import load_weights, seeded_initialisation
from training.models.gate import Gate
from training.models.lookups import make_lookups
from training.models.modules import make_critic, make_generator
from training.models.networks import Critic, MeansGenerator, TorusGenerator
from training.trials.arrays import TrainingArrays


def fresh_generator(config: GanConfig, arrays: TrainingArrays) -> TorusGenerator | MeansGenerator:
    """A generator of the shape that fits the data, not trained."""
    lookups = make_lookups(config.generator_lookups, arrays.robot, arrays.camera)
    looked_up = 0 if lookups is None else lookups.values
    return make_generator(config, arrays.robot.dim, arrays.mu.shape[1], arrays.scale, looked_up)


def load_generator(
    config: GanConfig, arrays: TrainingArrays, checkpoint: Path
) -> TorusGenerator | MeansGenerator:
    """The generator of a trial's checkpoint."""
    with seeded_initialisation(0):
        generator = fresh_generator(config, arrays)
    generator.load_state_dict(load_weights(checkpoint, "generator"))
    return generator


def torus_generator(generator: TorusGenerator | MeansGenerator) -> TorusGenerator:
    """The same, where only a torus generator will do.

    Raises:
        JobError: it is of the other kind.
    """
    if not isinstance(generator, TorusGenerator):
        raise JobError("a gate needs torus generators", expected="generator=torus", got="generator=means")
    return generator


def load_critic(config: GanConfig, arrays: TrainingArrays, checkpoint: Path) -> Critic:
    """The critic of a trial's checkpoint."""
    lookups = make_lookups(config.critic_lookups, arrays.robot, arrays.camera)
    looked_up = 0 if lookups is None else lookups.values
    dim, (scenarios, latent_dim) = arrays.robot.dim, arrays.mu.shape
    with seeded_initialisation(0):
        critic = make_critic(config, dim, latent_dim, scenarios, arrays.scale, looked_up)
    critic.load_state_dict(load_weights(checkpoint, "critic"))
    return critic


def load_gate(config: TrainConfig, checkpoint: Path) -> Gate:
    """The gate of a trial's checkpoint."""
    with seeded_initialisation(0):
        gate = Gate(config.gate, config.vae.latent_dim)
    gate.load_state_dict(load_weights(checkpoint, "gate"))
    return gate
