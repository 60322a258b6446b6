"""Whom a candidate is measured beside: champions of its robot and the shipped model, no more than three."""

from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import pytest

from cspace.bundle import Bundle
from cspace.errors import ModelNotFoundError
from cspace.worlds import robot_digest
from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK
from cspace.worlds.planar.world import PlanarWorld
from inference_api.settings import PRETRAINED_FOLDER
from services.evaluator.job import find_rivals
from services.names import MODEL_NAME
from services.registry.promotion import Decision, promote, record_decision, roll_back
from tests.bundles import write_tiny_bundle
from tests.fakes.registry import FakeRegistry


@pytest.fixture
def registry(tmp_path, verified_here):
    return FakeRegistry(tmp_path / "registry")


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """Writes a tiny bundle, another one for each number."""
    folder = tmp_path_factory.mktemp("bundles")

    @cache
    def write(number, robot, kind="configuration"):
        name = f"{number}-{robot.dim}-{kind}"
        return Bundle.load(write_tiny_bundle(folder / name, robot, scale=1.0 + number, kind=kind))

    return write


@pytest.fixture
def register(registry, tiny):
    """Registers a tiny bundle of its own, promoted with a precision where one is given."""

    def add(number, precision=None, robot=TWO_LINK, **how):
        bundle = tiny(number, robot, **how)
        assert registry.register(MODEL_NAME, bundle.folder, "run", bundle.digest, {}).number == number
        if precision is not None:
            promoted, metrics = True, {"precision": precision}
            digest = robot_digest(PlanarWorld(robot))
            decision = Decision(MODEL_NAME, number, promoted, ("made",), metrics, None, number, digest)
            record_decision(registry, decision)

    return add


@pytest.fixture
def rivals_of(registry, tmp_path):
    """The rivals of a version that is registered."""

    def find(number, shipped=None):
        version = registry.version(MODEL_NAME, number)
        bundle = Bundle.load(registry.download(version, Path(mkdtemp(dir=tmp_path)) / "candidate"))
        return find_rivals(registry, version, bundle, shipped, Path(mkdtemp(dir=tmp_path)))

    return find


def names(rivals):
    return [rival.name for rival in rivals]


def test_the_present_champion_and_the_best_before_it_are_measured_and_the_others_recorded(
    register, rivals_of
):
    for number, precision in ((1, 0.8), (2, 0.9), (3, 0.7), (4, 0.85), (5, None)):
        register(number, precision)
    rivals, bar = rivals_of(5)
    assert names(rivals) == ["version 4, the present champion", "version 2, the best before it"]
    assert [champion.version for champion in bar.recorded] == [1, 3]
    assert bar.against == 4
    assert bar.notes == ("not compared with the shipped model, as requested",)


@pytest.mark.parametrize("damage", [None, b"no graph"])
def test_a_champion_whose_bundle_is_gone_or_damaged_is_compared_by_its_record_which_is_said(
    registry, register, rivals_of, damage
):
    register(1, 0.8)
    register(2)
    download = registry.download

    def failing(version, folder):
        if version.number == 1 and damage is None:
            raise ModelNotFoundError("its bundle is gone")
        found = download(version, folder)
        if version.number == 1:
            (found / "encoder.onnx").write_bytes(damage)
        return found

    registry.download = failing
    rivals, bar = rivals_of(2)
    assert (names(rivals), [one.version for one in bar.recorded], bar.against) == ([], [1], 1)
    assert "version 1, the present champion, can not be measured again" in bar.notes[0]


def test_a_version_that_was_rolled_back_is_no_bar_any_more(registry, register, rivals_of):
    for number, precision in ((1, 0.7), (2, 0.8), (3, 0.99)):
        register(number, precision)
    roll_back(registry, MODEL_NAME, "worse in the field")
    register(4)
    rivals, bar = rivals_of(4)
    assert names(rivals) == ["version 2, the present champion", "version 1, the best before it"]
    assert bar.recorded == ()
    (note,) = (note for note in bar.notes if "version 3" in note)
    assert note.startswith("not compared with version 3, which was rolled back on 20")
    promote(registry, registry.version(MODEL_NAME, 3), "it was the camera")
    assert names(rivals_of(4)[0]) == ["version 3, the present champion", "version 2, the best before it"]


@pytest.mark.parametrize(
    ("how", "expected"), [({}, ["the shipped model"]), ({"robot": THREE_LINK}, []), ({"kind": "path"}, [])]
)
def test_the_shipped_model_is_a_rival_of_its_robot_and_kind_alone(register, rivals_of, how, expected):
    register(1, **how)
    rivals, bar = rivals_of(1, PRETRAINED_FOLDER)
    assert names(rivals) == expected
    assert (bar.notes == ("no model of this robot and kind is shipped",)) is (not expected)


def test_no_bundle_is_its_own_rival_or_one_twice(registry, register, rivals_of, tiny):
    register(1, 0.9)
    shipped = tiny(1, TWO_LINK)
    registry.register(MODEL_NAME, shipped.folder, "another run", shipped.digest, {})
    rivals, bar = rivals_of(2, shipped.folder)
    assert rivals == ()
    assert bar.notes[-1] == "the shipped model, is this very bundle"
    register(3)
    assert names(rivals_of(3, shipped.folder)[0]) == ["version 1, the present champion"]
