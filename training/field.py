"""Trains the field of space: ``python -m training.field FOLDER``. Stopped, it goes on where it was.

Views are simulated while it trains, so that it needs no data set. On a processor it takes a second a step.
``--measure N`` prints figures of a checkpoint instead, on N views of each family that training does not see.

Exit codes: 0 done, 2 the command is wrong.
"""

import argparse
import json
import logging
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import lightning
import numpy as np
import torch
from lightning.pytorch.callbacks import EMAWeightAveraging, ModelCheckpoint
from lightning.pytorch.loggers import CSVLogger
from numpy.typing import NDArray
from safetensors.torch import load_file, save_file
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from cspace.errors import ImageError, ScenarioError
from cspace.simulator import Split, scenario_rng
from cspace.worlds.spatial.bodies import distance_m
from cspace.worlds.spatial.obstacles import Obstacles
from cspace.worlds.spatial.scenes import draw_layout, scenes_of, seen, waiting
from cspace.worlds.spatial.world import SpatialWorld
from training.models.field import FieldModule, field_figures, new_field
from training.scene_model import TRAINED, disturbed, named_arm, scene_world

SCENE_MODEL = Path(__file__).with_name("pretrained") / "scene_model.safetensors"
BATCH, SAVE_EVERY = 2, 250
FAMILIES = ("cage", "bin", "shelf", "table", "under_table", "mixture")


View = tuple[NDArray[np.uint8], NDArray[np.bool_], NDArray[np.float32]]
"""An array (X, Y, Z, 2), which voxels are occupied (X, Y, Z), and the grid's lowest corner (3,) m."""


class FieldScenes(IterableDataset[View]):
    """Views of simulated scenes with their occupancy; the view of a number is always the same.

    Args:
        world: arm, sensor and scenes.
        first: number of the first view. A job that goes on gives the number of views that it has had.
        seed: of all draws.
    """

    def __init__(self, world: SpatialWorld, first: int, seed: int) -> None:
        self.world, self.first, self.seed = world, first, seed

    def __iter__(self) -> Iterator[View]:
        worker = get_worker_info()
        number, step = self.first, 1
        if worker is not None:
            number, step = number + worker.id, worker.num_workers
        low = np.asarray(self.world.sensor.grid.low_m, dtype=np.float32)
        while True:
            rng = scenario_rng(Split.TRAIN, self.seed, number)
            array, occupied = draw_view(self.world, Split.TRAIN, rng, number)
            # The scene, turned by quarters about the axis of the base.
            turns = int(rng.integers(4))
            yield np.rot90(array, turns).copy(), np.rot90(occupied, turns).copy(), low
            number += step


def draw_view(
    world: SpatialWorld, split: Split, rng: np.random.Generator, index: int, family: str | None = None
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """A view's array (X, Y, Z, 2), and which voxels are occupied, (X, Y, Z)."""
    while True:
        layout = draw_layout(scenes_of(world), split, int(rng.integers(2**62)), index, family)
        state = waiting(rng, world.body, layout.obstacles)
        try:
            array = world.observed(disturbed(rng, seen(rng, world, layout, state).view()))
        except (ScenarioError, ImageError):
            # No camera had room, or one saw nothing.
            continue
        return array, occupancy(world, layout.obstacles)


def occupancy(world: SpatialWorld, obstacles: Obstacles) -> NDArray[np.bool_]:
    """Which voxels of a world's grid are occupied, (X, Y, Z)."""
    grid = world.sensor.grid
    return np.asarray(distance_m(obstacles, grid.centres_m()) < 0.5 * grid.voxel_m)


def varied(world: SpatialWorld) -> SpatialWorld:
    """The world with more kinds of scenes: cages with solid faces, and cluttered bins."""
    scenes = scenes_of(world)
    cages = replace(scenes.cages, solid=0.5, objects=(0, 6), lowest_m=(-0.5, 0.45))
    bins = replace(scenes.bins, objects=(0, 10), lowest_m=(-0.65, 0.4))
    return replace(world, scenes=replace(scenes, cages=cages, bins=bins))


def main(arguments: Sequence[str] | None = None) -> int:
    """See the module."""
    options = parser().parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    world = varied(scene_world(named_arm(TRAINED)))
    net = new_field(world, load_file(SCENE_MODEL))
    folder: Path = options.folder
    folder.mkdir(parents=True, exist_ok=True)
    last = folder / "last.ckpt"
    state = torch.load(last, weights_only=True) if last.exists() else None
    done = 0 if state is None else int(state["global_step"])
    if options.measure:
        # Averaged weights, which the checkpoint holds as the module's own.
        weights = {} if state is None else state["state_dict"]
        low = torch.tensor(world.sensor.grid.low_m)
        net.load_state_dict({name.removeprefix("net."): value for name, value in weights.items()})
        for family in FAMILIES:
            rngs = [scenario_rng(Split.VALIDATION, 7, index) for index in range(options.measure)]
            views = [draw_view(world, Split.VALIDATION, rng, at, family) for at, rng in enumerate(rngs)]
            print(f"{done} steps, {family}: {json.dumps(field_figures(net.eval(), low, views))}", flush=True)
        return 0
    torch.set_num_threads(1)
    trainer = lightning.Trainer(
        max_steps=options.steps,
        gradient_clip_val=1.0,
        log_every_n_steps=50,
        logger=CSVLogger(folder, "log"),
        callbacks=[
            ModelCheckpoint(folder, save_last=True, save_top_k=0, every_n_train_steps=SAVE_EVERY),
            EMAWeightAveraging(decay=0.998),
        ],
    )
    scenes = FieldScenes(world, BATCH * done, options.seed)
    loader = DataLoader(scenes, batch_size=BATCH, num_workers=1, prefetch_factor=4)
    trainer.fit(FieldModule(net, options.steps), loader, ckpt_path=None if state is None else str(last))
    save_file(net.state_dict(), folder / "field.safetensors")
    return 0


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(prog="python -m training.field", description=__doc__)
    result.add_argument("folder", type=Path, help="takes checkpoints, a log and field.safetensors")
    result.add_argument("--steps", type=int, default=30_000, help="of 2 views each (default: %(default)s)")
    result.add_argument("--seed", type=int, default=0)
    result.add_argument(
        "--measure", type=int, default=0, metavar="N", help="print figures on N views a family"
    )
    return result


if __name__ == "__main__":
    sys.exit(main())
