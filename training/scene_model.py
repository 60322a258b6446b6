"""Trains the scene model, which serves any arm: ``python -m training.scene_model FOLDER``.

Draws scenes with the Panda and with random arms, and trains. Stopped, it goes on where it was. It takes 20
minutes with a GPU and 16 cores, and 26 GB of disk.

Exit codes: 0 done, 1 the disk is bad, 2 the command is wrong.
"""

import argparse
import logging
import multiprocessing
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from lightning.pytorch.callbacks import ModelCheckpoint, TQDMProgressBar
from numpy.typing import NDArray

from cspace.errors import ConfigError, CspaceError, ImageError, InputError, ScenarioError
from cspace.files import replacing
from cspace.simulator import Split, scenario_rng
from cspace.worlds import examples
from cspace.worlds.spatial.arm import Joint, Part, SerialArm
from cspace.worlds.spatial.camera import DepthCamera
from cspace.worlds.spatial.collision import CollisionChecker, group_hits
from cspace.worlds.spatial.poses import Frame, make_pose, pose_of, turned
from cspace.worlds.spatial.problems import draw_proposals
from cspace.worlds.spatial.scenes import draw_layout, scenes_of, seen, waiting
from cspace.worlds.spatial.view import DepthView
from cspace.worlds.spatial.world import SpatialWorld, usual
from services.commands import Progress, report_error
from training.config import ValidityConfig
from training.models.checkpoint import fit_module, save_scene_model, seeded_initialisation
from training.models.field import SIZES
from training.models.grid_training import ArmSamples, GridHeadModule, GridSamples

_LOG = logging.getLogger("training")
# Shares of scenes with the arm on a table or block, and with poses or a state that are a little wrong.
MOUNTED, POSE_OFF, STATE_OFF = 0.35, 0.3, 0.2
_POSE_SIGMA_M, _POSE_SIGMA_RAD, _STATE_SIGMA_RAD = 0.005, 0.009, 0.015
SHARD, CONFIGURATIONS, VIEWS = 25, 384, 2
# The shipped world's arm, and random ones.
TRAINED, RANDOM_ARMS, RANDOM_SCENES = "panda", 10, 300
_SAVE_EVERY = 2000
WEIGHTS = "scene_model.safetensors"
_AXES = {"y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
# Axes of joints from the base on, as arms have them that are sold.
_PATTERNS = ("zyzyzyz", "zyyyzy", "zyyzyz")
# Links that are so many joints apart can touch.
_APART = 3
_HOLDS = 0.3

_Sphere = tuple[float, float, float, float]


def scene_world(arm: SerialArm) -> SpatialWorld:
    """An arm in scenes as laboratories have them."""
    world = usual(arm)
    scenes = replace(scenes_of(world), mounted=MOUNTED)
    if arm.name != TRAINED:
        shoulder_m = arm.joints[0].origin.xyz_m[2]
        reach_m = float(np.clip(0.8 * (arm.reach_m - shoulder_m), 0.4, 0.95))
        scenes = replace(scenes, reach_m=reach_m, shoulder_m=shoulder_m)
    return replace(world, scenes=scenes)


def named_arm(name: str) -> SerialArm:
    """A shipped arm, or a random one by its number."""
    if name.startswith("random"):
        return random_arm(int(name.removeprefix("random")))
    body = examples()[name].body
    assert isinstance(body, SerialArm)  # noqa: S101 - for the type checker
    return body


def random_arm(seed: int) -> SerialArm:
    """An arm of six or seven joints: rods of spheres, with fingers that may hold something."""
    rng = np.random.default_rng(seed)
    pattern = _PATTERNS[int(rng.integers(len(_PATTERNS)))]
    size = rng.uniform(0.7, 1.2)
    steps = _steps(rng, pattern, size)
    joints, parts = [], []
    thick = rng.uniform(0.045, 0.09) * size
    for number, axis in enumerate(pattern, 1):
        bend = 2.8 if axis == "z" else rng.uniform(1.8, 2.6)
        joints.append(Joint(f"joint{number}", _frame(steps[number - 1]), _AXES[axis], (-bend, bend)))
        thick *= rng.uniform(0.85, 1.0)
        spheres = _rod(steps[number], thick)
        if number == len(pattern):
            spheres += _hand(rng, steps[-1], size)
        parts.append(Part(f"link{number}", number, tuple(spheres)))
    pairs = tuple((a.name, b.name) for i, a in enumerate(parts) for b in parts[i + _APART :])
    bent = [number for number, axis in enumerate(pattern) if axis == "y"]
    ready = dict(zip(bent, (0.2, 1.2, 0.8), strict=False))
    waits = tuple(ready.get(number, 0.0) for number in range(len(pattern)))
    return SerialArm(f"random{seed}", tuple(joints), tuple(parts), pairs, _frame(steps[-1]), waits)


def _frame(place_m: NDArray[np.float64]) -> Frame:
    x, y, z = (float(one) for one in place_m)
    return Frame((x, y, z))


def _steps(rng: np.random.Generator, pattern: str, size: float) -> list[NDArray[np.float64]]:
    """From each frame to the next one, m, and to the tool: long behind shoulder and elbow."""
    bends, found = 0, [np.array([0.0, 0.0, rng.uniform(0.1, 0.4) * size])]
    for axis in pattern[1:]:
        is_long = axis == "y" and 0 < bends < 3
        along = rng.uniform(0.3, 0.45) if is_long else rng.uniform(0.06, 0.14)
        bends += axis == "y"
        aside = rng.uniform(-0.1, 0.1, 2) * (rng.random(2) < 0.5)
        found.append(np.array([aside[0], aside[1], along]) * size)
    return [*found, np.array([0.0, 0.0, rng.uniform(0.06, 0.22) * size])]


def _rod(step: NDArray[np.float64], radius: float) -> list[_Sphere]:
    count = max(6, int(np.ceil(np.linalg.norm(step) / (0.5 * radius))))
    x, y, z = (float(one) for one in step)
    return [
        (share * x, share * y, share * z, float(radius)) for share in np.linspace(0.0, 1.0, count).tolist()
    ]


def _hand(rng: np.random.Generator, tip: NDArray[np.float64], size: float) -> list[_Sphere]:
    """Two fingers at the tip of the last link, and what joins them."""
    wide, radius = rng.uniform(0.03, 0.1) * size, rng.uniform(0.01, 0.025)
    back, end = rng.uniform(0.04, 0.12) * size, float(tip[2])
    found = [
        (0.0, side * wide, end - share * back, radius)
        for side in (-1, 1)
        for share in np.linspace(0.0, 1.0, 5).tolist()
    ]
    found += [(0.0, y, end - back, 1.5 * radius) for y in np.linspace(-wide, wide, 7).tolist()]
    if rng.random() < _HOLDS:
        half, radius = rng.uniform(0.05, 0.25) / 2.0, rng.uniform(0.02, 0.05)
        found += [(0.0, y, end, radius) for y in np.linspace(-half, half, 8).tolist()]
    return found


def disturbed(rng: np.random.Generator, view: DepthView) -> DepthView:
    """The same pictures, sometimes with poses or a state that are a little wrong, as real ones are."""
    cameras, state = view.cameras, view.states[0]
    if rng.random() < POSE_OFF:
        cameras = tuple(_moved(rng, camera) for camera in cameras)
    if state is not None and rng.random() < STATE_OFF:
        state = tuple(float(angle + rng.normal() * _STATE_SIGMA_RAD) for angle in state)
    return replace(view, cameras=cameras, state=state)


def _moved(rng: np.random.Generator, camera: DepthCamera) -> DepthCamera:
    off = make_pose(turned(*(rng.normal(size=3) * _POSE_SIGMA_RAD)), rng.normal(size=3) * _POSE_SIGMA_M)
    return replace(camera, pose=pose_of(camera.matrix @ off))


@dataclass(frozen=True, slots=True)
class SceneTask:
    """Some scenes of one arm, into one file."""

    folder: Path
    arm: str
    first: int
    count: int
    seed: int

    @property
    def path(self) -> Path:
        """Of the file."""
        return self.folder / f"{self.arm}-{self.first:06d}.npz"


def make_scenes(task: SceneTask) -> Path:
    """Draw, look, label and write, unless the file is there."""
    if not task.path.exists():
        world = scene_world(named_arm(task.arm))
        rows = [_scene(world, task, index) for index in range(task.first, task.first + task.count)]
        arrays = {name: np.stack([row[name] for row in rows]) for name in rows[0]}
        with replacing(task.path, "the file of scenes") as beside, beside.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)
    return task.path


def _scene(world: SpatialWorld, task: SceneTask, index: int) -> dict[str, NDArray[np.generic]]:
    """``images`` (V, X, Y, Z, 2), ``configurations`` (n, d) rad, ``free`` (n,), ``hits`` (n, G)."""
    rng = scenario_rng(Split.TRAIN, task.seed, index)
    while True:
        layout = draw_layout(scenes_of(world), Split.TRAIN, int(rng.integers(2**62)), index)
        checker = CollisionChecker(world.body, layout.obstacles)
        state, images = waiting(rng, world.body, layout.obstacles), []
        try:
            for _ in range(VIEWS):
                view = seen(rng, world, layout, state).view()
                images.append(world.observed(disturbed(rng, view)))
                state = waiting(rng, world.body, layout.obstacles)
        except (ScenarioError, ImageError):
            # No camera had room, or one saw nothing.
            continue
        drawn = draw_proposals(checker, layout.regions, state, rng, CONFIGURATIONS)
        stored = checker.space.to_float32(drawn.configurations)
        return {
            "images": np.stack(images),
            "configurations": stored,
            "free": np.asarray(checker.clearance(stored) > 0.0),
            "hits": group_hits(world.body, layout.obstacles, stored, SIZES.groups),
        }


def load_samples(paths: Iterable[Path]) -> GridSamples:
    """The pictures of scenes, each with its scene's configurations."""
    shards = []
    for path in paths:
        with np.load(path, allow_pickle=False) as arrays:
            shards.append(dict(arrays))
    images = np.concatenate([one["images"].reshape(-1, *one["images"].shape[2:]) for one in shards])
    views, each = shards[0]["images"].shape[1], shards[0]["configurations"].shape[1]
    configurations, free, hits = (
        torch.from_numpy(np.repeat(np.concatenate([one[name] for one in shards]), views, axis=0)).flatten(
            0, 1
        )
        for name in ("configurations", "free", "hits")
    )
    return GridSamples(images, configurations, free, hits, torch.arange(len(images) + 1) * each)


def plan_tasks(folder: Path, scenes: int, seed: int) -> list[SceneTask]:
    """What is to be drawn."""
    counts = {TRAINED: scenes} | {f"random{number}": RANDOM_SCENES for number in range(RANDOM_ARMS)}
    return [
        SceneTask(folder, arm, first, min(SHARD, count - first), seed)
        for arm, count in counts.items()
        for first in range(0, count, SHARD)
    ]


def draw_all(tasks: Sequence[SceneTask], processes: int) -> None:
    """Make the files of all tasks that are not there."""
    todo = [task for task in tasks if not task.path.exists()]
    if not todo:
        return
    context = multiprocessing.get_context("spawn")
    with (
        ProcessPoolExecutor(processes, mp_context=context) as pool,
        Progress("scenes", len(todo), _LOG.info, "file") as bar,
    ):
        # The first alone, so that kernels are compiled once.
        pool.submit(make_scenes, todo[0]).result()
        bar.advance()
        for _ in pool.map(make_scenes, todo[1:]):
            bar.advance()


def train(config: ValidityConfig, held: ArmSamples, seed: int, folder: Path) -> GridHeadModule:
    """The trained module; goes on from the checkpoint of the folder where there is one."""
    with seeded_initialisation(seed):
        module = GridHeadModule(config, held, seed)
    checkpoint = ModelCheckpoint(
        folder, "last", every_n_train_steps=min(_SAVE_EVERY, config.steps), enable_version_counter=False
    )
    fit_module(module, config.steps, folder / "last.ckpt", [checkpoint, TQDMProgressBar(refresh_rate=50)])
    return module


def main(arguments: Sequence[str] | None = None) -> int:
    """See the module."""
    parser = argparse.ArgumentParser(prog="python -m training.scene_model", description=__doc__)
    parser.add_argument("folder", type=Path, help="takes scenes, a checkpoint and scene_model.safetensors")
    parser.add_argument("--scenes", type=int, default=9000, help="with the Panda; 2 MB each (default: 9000)")
    parser.add_argument("--steps", type=int, default=19532, help="of 16 pictures each (default: 19532)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=multiprocessing.cpu_count(), help="that draw scenes")
    options = parser.parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    folder = options.folder.absolute()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        draw_and_train(folder, options)
    except CspaceError as error:
        return report_error(error, InputError, ConfigError)
    return 0


def draw_and_train(folder: Path, options: argparse.Namespace) -> None:
    """Draw, train, write the weights."""
    tasks = plan_tasks(folder, options.scenes, options.seed)
    draw_all(tasks, options.processes)
    config = ValidityConfig(
        steps=options.steps,
        pictures_per_step=16,
        configurations_per_picture=160,
        hidden=48,
        learning_rate=2e-3,
        grid=SIZES,
    )
    arms = list(dict.fromkeys(task.arm for task in tasks))
    held = ArmSamples(
        tuple(scene_world(named_arm(arm)) for arm in arms),
        tuple(load_samples(task.path for task in tasks if task.arm == arm) for arm in arms),
    )
    module = train(config, held, options.seed, folder)
    save_scene_model(folder / WEIGHTS, module.head.model)


if __name__ == "__main__":
    raise SystemExit(main())
