"""From trained weights to a bundle."""

import math
from dataclasses import dataclass
from pathlib import Path

from torch import Tensor

from cspace.bundle import Bundle, BundleSpec, Provenance, RandomInput, write_bundle
from cspace.dataset import Dataset
from cspace.space import Standardisation
from training.config import GanConfig, TrainConfig
from training.encode import load_encoder
from training.models.checkpoint import load_weights, seeded_initialisation
from training.models.export import encoder_graph, generator_graph, validity_graph
from training.models.modules import make_generator
from training.models.validity import ValidityHead
from training.provenance import command_line, now, source_state


@dataclass(frozen=True, slots=True)
class TrainedParts:
    """What the trials left.

    Args:
        encoder: checkpoint of the VAE, or the generator's own where the two were trained together.
        generator: checkpoint of the global WGAN-GP.
        validity: checkpoint of the validity head, if there is one.
        scale: mean and standard deviation of the configurations that were trained on, each (d,) rad.
    """

    encoder: Path
    generator: Path
    validity: Path | None
    scale: tuple[Tensor, Tensor]


def make_bundle(folder: Path, config: TrainConfig, dataset: Dataset, parts: TrainedParts) -> Bundle:
    """Export the networks, write the bundle, and load it again as any reader would.

    Raises:
        BundleError: the exported graphs do not make a bundle.
        StorageError: the folder exists or cannot be written.
    """
    gan, latent_dim, dim = config.global_, config.vae.latent_dim, dataset.dim
    with seeded_initialisation(0):
        generator = make_generator(gan, dim, latent_dim, parts.scale)
    generator.load_state_dict(load_weights(parts.generator, "generator"))
    encoder = load_encoder(config.vae, dataset.camera.pixels, parts.encoder)
    graphs = {
        "encoder": encoder_graph(encoder, dataset.camera.pixels),
        "generator": generator_graph(generator, dim, latent_dim, gan.noise_dim),
    }
    if parts.validity is not None:
        with seeded_initialisation(0):
            head = ValidityHead(config.validity, dataset.robot, dataset.camera)
        head.load_state_dict(load_weights(parts.validity, "head"))
        graphs["validity"] = validity_graph(head, dataset.camera.pixels, dim)
    scale = Standardisation(*(tuple(float(v) for v in part) for part in parts.scale))
    spec = BundleSpec(
        robot=dataset.robot,
        latent_dim=latent_dim,
        camera=dataset.camera,
        samples_per_latent=gan.means,
        random_inputs=random_inputs(gan, dim),
        confidence_threshold=None if parts.validity is None else config.validity.threshold,
        standardisation=scale if gan.generator == "means" else None,
        provenance=_provenance(config, dataset),
    )
    return Bundle.load(write_bundle(folder, spec, graphs))


def random_inputs(gan: GanConfig, dim: int) -> tuple[RandomInput, ...]:
    """The random inputs of a generator's graph, in the order in which they are drawn."""
    if gan.generator == "means":
        return (RandomInput("noise", "normal", (gan.means, dim)),)
    return (
        RandomInput("base", "uniform", (dim,), -math.pi, math.pi),
        RandomInput("noise", "normal", (gan.noise_dim,)),
    )


def _provenance(config: TrainConfig, dataset: Dataset) -> Provenance:
    source = source_state()
    return Provenance(
        git_commit=source.commit,
        git_dirty=source.dirty,
        data_digest=dataset.digest,
        seeds={"train": config.seed, "data": config.data.seed},
        config=config.to_dict(),
        created=now(),
        command=command_line(),
    )
