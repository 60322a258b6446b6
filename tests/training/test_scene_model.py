"""python -m training.scene_model: what it draws with several arms, trains with them, and any arm takes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from cspace.errors import ConfigError
from cspace.worlds import examples, usual_world
from cspace.worlds.spatial.arm import Joint, Part, SerialArm, ready_rad
from cspace.worlds.spatial.camera import DepthCamera, looking
from cspace.worlds.spatial.collision import CollisionChecker
from cspace.worlds.spatial.obstacles import Obstacles
from cspace.worlds.spatial.poses import Frame
from cspace.worlds.spatial.view import DepthView
from training.config import SCENE_MODEL, GridConfig, TrainConfig, ValidityConfig
from training.models.checkpoint import load_scene_model, save_scene_model
from training.models.grid_head import GridHead, counts_of
from training.models.grid_training import ArmSamples
from training.scene_model import (
    SceneTask,
    disturbed,
    load_samples,
    make_scenes,
    named_arm,
    random_arm,
    scene_world,
    train,
)

SMALL = GridConfig(finest=4, width=4, middle=4, deep=4)
JOINTS = tuple(Joint(name, Frame((0.0, 0.0, 0.3)), (0.0, 1.0, 0.0), (-2.0, 2.0)) for name in "ab")
RODS = tuple(Part(f"l{number}", number, ((0.0, 0.0, 0.0, 0.05), (0.0, 0.0, 0.2, 0.05))) for number in (1, 2))
FEW_SPHERES = SerialArm("few", JOINTS, RODS, (), Frame((0.0, 0.0, 0.3)))
PANDA, UR5 = (examples()[name] for name in ("panda", "ur5"))


@pytest.mark.parametrize("seed", range(6))
def test_a_random_arm_waits_free_of_itself_and_has_enough_spheres(seed: int) -> None:
    arm = random_arm(seed)
    world = scene_world(arm)
    assert arm == random_arm(seed)
    assert arm.dim in (6, 7)
    assert 0.4 < arm.reach_m < 2.0
    assert world.grid_arm(SMALL.groups).group_links.min() > 0
    assert CollisionChecker(arm, Obstacles()).valid(ready_rad(arm))


@pytest.fixture(scope="module")
def tasks(tmp_path_factory: pytest.TempPathFactory) -> list[SceneTask]:
    folder = tmp_path_factory.mktemp("scenes")
    made = [SceneTask(folder, arm, 3, 2, 0) for arm in ("panda", "random0")]
    for task in made:
        make_scenes(task)
    return made


@pytest.mark.slow
def test_scenes_are_the_same_again_and_labelled_by_what_is_hit(
    tasks: list[SceneTask], tmp_path: Path
) -> None:
    again = make_scenes(replace(tasks[0], folder=tmp_path))
    first, second = np.load(tasks[0].path), np.load(again)
    for name in ("images", "configurations", "free", "hits"):
        np.testing.assert_array_equal(first[name], second[name])
    assert first["images"].shape == (2, 2, *PANDA.sensor.picture_shape)
    # What hits something is not free; what is neither touches itself.
    assert not (first["hits"].any(axis=2) & first["free"]).any()
    assert 0.05 < first["free"].mean() < 0.95
    samples = load_samples([tasks[0].path])
    assert (len(samples.images), int(samples.offsets[-1])) == (4, len(samples.configurations))
    np.testing.assert_array_equal(samples.configurations[:384], first["configurations"][0])
    np.testing.assert_array_equal(samples.configurations[384:768], first["configurations"][0])
    np.testing.assert_array_equal(samples.images[1], first["images"][0, 1])


@pytest.mark.slow
def test_one_model_learns_with_arms_of_other_sizes_and_serves_a_third(
    tasks: list[SceneTask], tmp_path: Path
) -> None:
    config = ValidityConfig(
        steps=12, pictures_per_step=2, configurations_per_picture=40, hidden=8, grid=SMALL
    )
    held = ArmSamples(
        tuple(scene_world(named_arm(task.arm)) for task in tasks),
        tuple(load_samples([task.path]) for task in tasks),
    )
    module = train(config, held, 0, tmp_path / "checkpoint")
    # What is finished is not trained again.
    again = train(config, held, 0, tmp_path / "checkpoint")
    for one, other in zip(module.parameters(), again.parameters(), strict=True):
        torch.testing.assert_close(one, other, rtol=0.0, atol=0.0)
    path = tmp_path / "scene_model.safetensors"
    save_scene_model(path, module.head.model)
    head = GridHead(load_scene_model(path, UR5), UR5.grid_arm(SMALL.groups), counts_of(UR5))
    picture = torch.rand(1, 2, *head.counts)
    rows = torch.from_numpy(UR5.space.to_float32(UR5.space.sample_uniform(np.random.default_rng(0), 50)))
    with torch.no_grad():
        free = head(picture, head.encode(picture), rows[None]).free
    assert free.shape == (1, 50)
    assert bool(((free >= 0.0) & (free <= 1.0)).all())


def test_pose_and_state_are_off_by_little_and_pictures_are_not_touched() -> None:
    camera = DepthCamera.of_field(128, 128, 70.0, looking((1.5, 0.0, 0.8), (0.0, 0.0, 0.4)))
    view = DepthView((np.full(camera.picture_shape, 4000, np.uint16),), (camera,))
    moved = [disturbed(np.random.default_rng(seed), view) for seed in range(40)]
    gaps = [np.linalg.norm(one.cameras[0].matrix[:3, 3] - view.cameras[0].matrix[:3, 3]) for one in moved]
    assert 4 <= sum(gap > 0.0 for gap in gaps) <= 22
    assert max(gaps) < 0.03
    assert all(one.pictures is view.pictures for one in moved)


def test_the_shipped_model_serves_arms_of_any_size_and_no_voxels_of_another_size(tmp_path: Path) -> None:
    for arm in (PANDA.body, UR5.body, random_arm(3), FEW_SPHERES):
        world = usual_world(arm)
        model = load_scene_model(SCENE_MODEL, world)
        head = GridHead(model, world.grid_arm(model.config.groups), counts_of(world))
        assert head.groups <= min(model.config.groups, arm.sphere_count)
        picture, rows = torch.rand(1, 2, *head.counts), torch.zeros(1, 3, arm.dim)
        with torch.no_grad():
            assert head(picture, head.encode(picture), rows).free.isfinite().all()
    coarse = replace(PANDA, sensor=replace(PANDA.sensor, grid=replace(PANDA.sensor.grid, voxel_m=0.05)))
    with pytest.raises(ConfigError, match=r"voxels of 0.025 m; got 0.05 m; train a head"):
        load_scene_model(SCENE_MODEL, coarse)
    for content in (b"", b"no weights", SCENE_MODEL.read_bytes()[:-8]):
        (tmp_path / "broken.safetensors").write_bytes(content)
        with pytest.raises(ConfigError, match="the scene model cannot be read"):
            load_scene_model(tmp_path / "broken.safetensors", PANDA)
    with pytest.raises(ConfigError, match="the scene model cannot be read"):
        load_scene_model(tmp_path / "nowhere", PANDA)


def test_a_job_takes_the_shipped_model_its_own_or_trains_a_head() -> None:
    assert TrainConfig.load("panda_quick", []).validity.scene_model_file == SCENE_MODEL
    assert TrainConfig.load("panda_quick", ["validity.scene_model=/x/y"]).validity.scene_model_file == Path(
        "/x/y"
    )
    assert TrainConfig.load("panda_quick", ["validity.scene_model=null"]).validity.scene_model_file is None
    with pytest.raises(ConfigError, match=r"needs validity\.grid"):
        TrainConfig.load("quickstart", ["validity.scene_model=shipped"])
