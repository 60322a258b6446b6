"""A bundle of an arm in space whose networks are tiny and not trained."""

import os
import tempfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType

import numpy as np
from filelock import FileLock

from cspace.bundle import BundleSpec, RandomInput, write_bundle
from cspace.worlds import examples
from training.config import GridConfig, ValidityConfig
from training.models.autoencoders import Decoder, Encoder, NoveltyScores, network_size, shown_size
from training.models.checkpoint import seeded_initialisation
from training.models.export import encoder_graph, generator_graph, novelty_graph
from training.models.families.wgan_gp import Sizes, TorusGenerator, TorusSampler
from training.models.grid_head import GridHead
from training.models.grid_training import grid_validity_graph, map_graph

WORLD = examples()["panda"]
LATENT = 5
HEAD = ValidityConfig(hidden=8, grid=GridConfig(width=4, middle=4, deep=4))
SPEC = BundleSpec(
    world=WORLD,
    latent_dim=LATENT,
    random_inputs=(
        RandomInput("base", "uniform", (WORLD.dim,), -np.pi, np.pi),
        RandomInput("noise", "normal", (2,)),
    ),
    confidence_threshold=0.1,
    novelty_quantiles=((0.0, 1.0), (0.0, 1.0)),
)


@cache
def space_graphs() -> Mapping[str, bytes]:
    """Encoder, generator, novelty, map and validity; exported once a test run, which takes 20 s."""
    run = os.environ.get("PYTEST_XDIST_TESTRUNUID")
    if run is None:
        return MappingProxyType(_exported())
    folder = Path(tempfile.gettempdir()) / f"space-graphs-{run}"
    with FileLock(f"{folder}.lock"):
        if not folder.exists():
            graphs = _exported()
            folder.mkdir()
            for name, graph in graphs.items():
                (folder / f"{name}.onnx").write_bytes(graph)
    return MappingProxyType({file.stem: file.read_bytes() for file in folder.iterdir()})


def _exported() -> dict[str, bytes]:
    sensor, size = WORLD.sensor, network_size(WORLD.sensor)
    with seeded_initialisation(0):
        encoder = Encoder(shown_size(sensor), LATENT, 4)
        decoder = Decoder(shown_size(sensor), LATENT, 4)
        generator = TorusGenerator(Sizes(WORLD.space, LATENT, 8, 1), 2)
        head = GridHead.of(HEAD, WORLD).eval()
    return {
        "encoder": encoder_graph(encoder, size),
        "generator": generator_graph(TorusSampler(generator), LATENT),
        "novelty": novelty_graph(NoveltyScores(decoder, shown_size(sensor)).eval(), size, LATENT),
        "map": map_graph(head),
        "validity": grid_validity_graph(head, WORLD.dim),
    }


def write_space_bundle(folder: Path) -> Path:
    """The bundle, written."""
    return write_bundle(folder, SPEC, space_graphs())
