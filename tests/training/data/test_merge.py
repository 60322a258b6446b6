"""Data sets that grow: merged, each scenario once, with where all of it comes from."""

import numpy as np
import pytest

from cspace.dataset import open_dataset
from cspace.errors import DatasetError
from cspace.worlds.planar.arm import THREE_LINK
from training.config import TrainConfig
from training.data.__main__ import main
from training.data.config import DatasetConfig
from training.data.configurations import ConfigurationRecipe
from training.data.merge import merge

SMALL = DatasetConfig(scenario_count=4, free_per_scenario=6, collision_per_scenario=3, extra_image_count=2)


def made(folder, **changes):
    recipe = ConfigurationRecipe(SMALL.model_copy(update=changes))
    return recipe.write(folder, recipe.make)


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    return made(tmp_path_factory.mktemp("first") / "data")


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    return made(tmp_path_factory.mktemp("other") / "data", seed=1)


def test_all_scenarios_keep_their_configurations_and_their_geometry(first, other, tmp_path):
    merged = merge([first, other], tmp_path / "merged")
    assert merged.scenario_count == 8
    for index in range(4):
        assert np.array_equal(merged.free_of(4 + index), other.free_of(index))
        assert np.array_equal(merged.collision_of(index), first.collision_of(index))
        assert np.array_equal(merged.arrays["discs"][4 + index], other.arrays["discs"][index])
    assert len(merged.extra_images) == 4
    assert open_dataset(merged.folder, verify=True).digest == merged.digest


def test_a_scenario_that_is_there_already_is_left_out(first, tmp_path):
    # Of the same seed: the first four scenarios, and pictures, are those of the smaller one.
    grown = made(tmp_path / "grown", scenario_count=6)
    merged = merge([first, grown], tmp_path / "merged")
    assert merged.scenario_count == 6
    assert len(merged.extra_images) == 2
    assert np.array_equal(merged.images, grown.images)
    assert [part["left_out"] for part in merged.manifest.generator["merged"]] == [0, 4]


def test_the_manifest_tells_where_all_parts_come_from_and_can_be_merged_again(first, other, tmp_path):
    merged = merge([first, other], tmp_path / "merged")
    generator = merged.manifest.generator
    assert [part["digest"] for part in generator["merged"]] == [first.digest, other.digest]
    assert generator["merged"][1]["generator"] == dict(other.manifest.generator)
    assert (generator["split"], merged.generator_seed) == ("train", first.generator_seed)
    again = merge([merged, made(tmp_path / "third", seed=2)], tmp_path / "again")
    assert again.scenario_count == 12
    assert again.manifest.generator["merged"][0]["generator"] == dict(generator)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"robot": THREE_LINK}, "another world"),
        ({"split": "test"}, "another split"),
        ({"collision_per_scenario": 0}, "other files"),
    ],
)
def test_data_sets_that_do_not_fit_each_other_are_refused_by_name(first, changes, message, tmp_path):
    wrong = made(tmp_path / "wrong", **changes)
    with pytest.raises(DatasetError, match=f"wrong is of {message}"):
        merge([first, wrong], tmp_path / "merged")
    assert not (tmp_path / "merged").exists()


def test_the_command_merges_and_says_what_it_left_out(first, other, tmp_path, capsys):
    out = tmp_path / "merged"
    assert main(["merge", str(first.folder), str(other.folder), str(first.folder), str(out)]) == 0
    printed = capsys.readouterr().out
    assert "left out as there already: 4 scenarios" in printed
    assert open_dataset(out).digest in printed
    assert main(["merge", str(first.folder), str(other.folder), str(out)]) == 1
    assert "folder exists" in capsys.readouterr().err
    assert TrainConfig.load("smoke", [f"data_folder={out}"]).world.to_dict() == first.world.to_dict()
