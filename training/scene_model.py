"""Trains the scene model, which serves any arm: ``python -m training.scene_model FOLDER``.

Draws scenes with the Panda and with random arms, trains, and measures on scenes and arms that training does
not see. Stopped, it goes on where it was. It takes 20 minutes with a GPU and 16 cores, and 26 GB of disk.

With ``--register`` the weights become a version of ``scene-model``, and its champion where they are better;
``--fetch`` writes those of a version into the folder instead of training.

Exit codes: 0 done, 1 the disk or the registry is bad, 2 the command is wrong.
"""

import argparse
import hashlib
import json
import logging
import multiprocessing
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from lightning.pytorch.callbacks import ModelCheckpoint, TQDMProgressBar
from numpy.typing import NDArray

from cspace.errors import (
    BundleIntegrityError,
    ConfigError,
    CspaceError,
    ImageError,
    InputError,
    ModelNotFoundError,
    ScenarioError,
)
from cspace.files import replacing
from cspace.simulator import Split, scenario_rng
from cspace.worlds import examples
from cspace.worlds.spatial.arm import SerialArm
from cspace.worlds.spatial.camera import DepthCamera
from cspace.worlds.spatial.checks import CollisionChecker, group_hits
from cspace.worlds.spatial.poses import make_pose, pose_of, turned
from cspace.worlds.spatial.problems import draw_proposals
from cspace.worlds.spatial.scenes import draw_layout, scenes_of, seen, waiting
from cspace.worlds.spatial.view import DepthView
from cspace.worlds.spatial.world import SpatialWorld, usual
from services import progress
from services.commands import report_error
from services.names import (
    ALIAS_CHALLENGER,
    ALIAS_CHAMPION,
    SCENE_MODEL_FILE,
    SCENE_MODEL_NAME,
    SCENE_MODELS_EXPERIMENT,
    TAG_DIGEST,
    TAG_STAGE,
)
from services.registry import connect, tracking_uri
from services.registry.entities import ID, ModelReference, ModelVersion
from services.registry.models import ModelRegistry
from services.registry.tracking import Tracking
from training.config import ValidityConfig
from training.models.checkpoint import fit_module, save_scene_model, seeded_initialisation
from training.models.field import SIZES
from training.models.grid_head import GridHead, counts_of
from training.models.grid_training import ArmSamples, GridHeadModule, GridSamples
from training.random_arms import random_arm

_LOG = logging.getLogger("training")
# Shares of scenes with the arm on a table or block, and with poses or a state that are a little wrong.
MOUNTED, POSE_OFF, STATE_OFF = 0.35, 0.3, 0.2
_POSE_SIGMA_M, _POSE_SIGMA_RAD, _STATE_SIGMA_RAD = 0.005, 0.009, 0.015
SHARD, CONFIGURATIONS, VIEWS = 25, 384, 2
# Arms of the shipped world, random ones, and those that are measured alone.
TRAINED, RANDOM_ARMS, RANDOM_SCENES, HELD_OUT = "panda", 10, 300, ("panda", "ur5", "random1000")
HELD_OUT_SCENES = 200
_SAVE_EVERY = 2000


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
    split: Split
    first: int
    count: int
    views: int
    seed: int

    @property
    def path(self) -> Path:
        """Of the file."""
        return self.folder / f"{self.arm}-{self.split.value}-{self.first:06d}.npz"


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
    rng = scenario_rng(task.split, task.seed, index)
    while True:
        layout = draw_layout(scenes_of(world), task.split, int(rng.integers(2**62)), index)
        checker = CollisionChecker(world.body, layout.obstacles)
        state, images = waiting(rng, world.body, layout.obstacles), []
        try:
            for _ in range(task.views):
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


def plan_tasks(folder: Path, scenes: int, seed: int) -> tuple[list[SceneTask], list[SceneTask]]:
    """What is to be drawn: for training, and to be measured on."""
    counts = {TRAINED: scenes} | {f"random{number}": RANDOM_SCENES for number in range(RANDOM_ARMS)}
    trained = [
        SceneTask(folder, arm, Split.TRAIN, first, min(SHARD, count - first), VIEWS, seed)
        for arm, count in counts.items()
        for first in range(0, count, SHARD)
    ]
    measured = [
        SceneTask(folder, arm, Split.VALIDATION, first, SHARD, 1, seed)
        for arm in HELD_OUT
        for first in range(0, HELD_OUT_SCENES, SHARD)
    ]
    return trained, measured


def draw_all(tasks: Sequence[SceneTask], processes: int) -> None:
    """Make the files of all tasks that are not there."""
    todo = [task for task in tasks if not task.path.exists()]
    if not todo:
        return
    context = multiprocessing.get_context("spawn")
    with (
        ProcessPoolExecutor(processes, mp_context=context) as pool,
        progress.Progress("scenes", len(todo), _LOG.info, "file") as bar,
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


@torch.no_grad()
def measure(head: GridHead, samples: GridSamples) -> dict[str, float]:
    """How right a head is of obstacles in scenes that it has not seen, self-collision left out."""
    device, found = head.radii.device, []
    offsets = samples.offsets.tolist()
    for index, (first, last) in enumerate(pairwise(offsets)):
        image = torch.as_tensor(np.asarray(samples.images[index])).movedim(-1, 0)[None].to(device) / 255.0
        asked = samples.configurations[first:last][None].to(device)
        found.append(head(image, head.encode(image), asked).clear[0].exp().cpu())
    clear, truth = torch.cat(found), ~samples.hits.any(dim=-1)
    passed = clear > 0.9
    return {
        "accuracy": float(((clear > 0.5) == truth).float().mean()),
        "false_free_above_0.9": float((~truth)[passed].float().mean()),
        "free_above_0.9": float(passed[truth].float().mean()),
        "mean": float(clear.mean()),
        "free": float(truth.float().mean()),
    }


# How many more of those that pass may be in collision for an arm, before a model is no better.
_MARGIN = 0.005
ACCURACY, FALSE_FREE = "accuracy", "false_free_above_0.9"

Figures = Mapping[str, Mapping[str, float]]


def register(
    file: Path, figures: Figures, params: Mapping[str, Any], tracking: Tracking, registry: ModelRegistry
) -> ModelVersion:
    """Make weights a version: the champion where they are better than those of the one before.

    Better is a higher accuracy on average over the held-out arms, with no arm for which 0.5 percentage points
    more of what passes a confidence of 0.9 are in collision. The same weights are registered once.
    """
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    flat = {f"{arm}.{name}": value for arm, found in figures.items() for name, value in found.items()}
    champion = None
    with suppress(ModelNotFoundError):
        champion = registry.by_alias(SCENE_MODEL_NAME, ALIAS_CHAMPION)
    is_champion = champion is None or champion.digest == digest or _is_better(figures, champion.tags)
    tags = {TAG_STAGE: "scene model", TAG_DIGEST: digest}
    with tracking.start(SCENE_MODELS_EXPERIMENT, f"scene model, {ID}", tags=tags, key=digest) as run:
        run.params(params)
        run.metrics(flat, 0)
        run.artifact(file)
    alias = ALIAS_CHAMPION if is_champion else ALIAS_CHALLENGER
    values = {name: repr(value) for name, value in flat.items()}
    return registry.record(SCENE_MODEL_NAME, run.run_id, {TAG_DIGEST: digest, **values}, alias=alias)


def fetch(reference: str, file: Path, tracking: Tracking, registry: ModelRegistry) -> ModelVersion:
    """Write the weights of a version."""
    named = ModelReference.parse(reference)
    if named.name != SCENE_MODEL_NAME:
        raise InputError(
            "the reference is of no scene model", expected=f"{SCENE_MODEL_NAME}@champion", got=reference
        )
    version = registry.look_up(named)
    with TemporaryDirectory() as folder:
        kept = tracking.file(version.run_id, SCENE_MODEL_FILE, Path(folder))
        if kept is None:
            raise ModelNotFoundError(f"the run of {version} keeps no weights", expected=SCENE_MODEL_FILE)
        data = kept.read_bytes()
    if (found := hashlib.sha256(data).hexdigest()) != version.digest:
        raise BundleIntegrityError(
            f"the weights of {version} are not those that were registered", expected=version.digest, got=found
        )
    with replacing(file, "the scene model") as beside:
        beside.write_bytes(data)
    return version


def _is_better(figures: Figures, before: Mapping[str, str]) -> bool:
    gained = 0.0
    for arm, found in figures.items():
        # An arm that the champion was not measured with says nothing.
        if f"{arm}.{ACCURACY}" not in before:
            continue
        accuracy, false_free = (float(before[f"{arm}.{name}"]) for name in (ACCURACY, FALSE_FREE))
        if found[FALSE_FREE] > false_free + _MARGIN:
            return False
        gained += found[ACCURACY] - accuracy
    return gained > 0.0


def main(arguments: Sequence[str] | None = None) -> int:
    """See the module."""
    parser = argparse.ArgumentParser(prog="python -m training.scene_model", description=__doc__)
    parser.add_argument("folder", type=Path, help="takes scenes, a checkpoint and scene_model.safetensors")
    parser.add_argument("--scenes", type=int, default=9000, help="with the Panda; 2 MB each (default: 9000)")
    parser.add_argument("--steps", type=int, default=19532, help="of 16 pictures each (default: 19532)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=multiprocessing.cpu_count(), help="that draw scenes")
    kept = parser.add_mutually_exclusive_group()
    kept.add_argument("--register", action="store_true", help="at MLFLOW_TRACKING_URI")
    kept.add_argument("--fetch", metavar="VERSION", help="scene-model@champion or scene-model/3")
    options = parser.parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    folder = options.folder.absolute()
    try:
        # Before hours of training.
        uri = tracking_uri() if options.register or options.fetch else ""
        folder.mkdir(parents=True, exist_ok=True)
        if options.fetch:
            version = fetch(options.fetch, folder / SCENE_MODEL_FILE, *connect(uri))
            _LOG.info("%s: %s", folder / SCENE_MODEL_FILE, version)
            return 0
        figures = trained_and_measured(folder, options)
        if options.register:
            params = {name: getattr(options, name) for name in ("scenes", "steps", "seed")}
            version = register(folder / SCENE_MODEL_FILE, figures, params, *connect(uri))
            _LOG.info("registered as %s, %s", version, ", ".join(version.aliases))
    except CspaceError as error:
        return report_error(error, InputError, ConfigError)
    return 0


def trained_and_measured(folder: Path, options: argparse.Namespace) -> dict[str, dict[str, float]]:
    """Draw, train and write the weights; figures of each held-out arm."""
    tasks, held_out = plan_tasks(folder, options.scenes, options.seed)
    draw_all([*held_out, *tasks], options.processes)
    config = ValidityConfig(
        free_share=0.6,
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
    save_scene_model(folder / SCENE_MODEL_FILE, module.head.model)
    figures, device = {}, torch.device("cuda" if torch.cuda.is_available() else "cpu")
    for arm in HELD_OUT:
        world = scene_world(named_arm(arm))
        head = GridHead(module.head.model, world.grid_arm(SIZES.groups), counts_of(world))
        figures[arm] = measure(
            head.to(device).eval(), load_samples(task.path for task in held_out if task.arm == arm)
        )
        _LOG.info("%s: %s", arm, json.dumps(figures[arm]))
    return figures


if __name__ == "__main__":
    raise SystemExit(main())
