"""Whom a candidate is measured beside: the present champion of its robot."""

from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import pytest

from cspace.bundle import Bundle
from cspace.errors import ModelNotFoundError
from cspace.worlds import robot_digest
from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK
from cspace.worlds.planar.world import PlanarWorld
from services.evaluator.job import find_champion
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
    """The champion that a registered version is measured beside, and the bar."""

    def find(number):
        version = registry.version(MODEL_NAME, number)
        bundle = Bundle.load(registry.download(version, Path(mkdtemp(dir=tmp_path)) / "candidate"))
        champion, bar = find_champion(registry, version, bundle, Path(mkdtemp(dir=tmp_path)) / "champion")
        return champion and champion.digest, bar

    return find


def recorded(bar):
    return [champion.version for champion in bar.recorded]


def test_the_present_champion_is_measured_and_earlier_ones_are_recorded(registry, register, rivals_of):
    for number, precision in ((1, 0.8), (2, 0.9), (3, 0.7), (4, None)):
        register(number, precision)
    digest, bar = rivals_of(4)
    assert digest == registry.version(MODEL_NAME, 3).digest
    assert (recorded(bar), bar.against, bar.notes) == ([1, 2], 3, ())


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
    digest, bar = rivals_of(2)
    assert (digest, recorded(bar), bar.against) == (None, [1], 1)
    assert "/1 can not be measured again" in bar.notes[0]


def test_a_version_that_was_rolled_back_is_no_bar_until_it_is_promoted_again(registry, register, rivals_of):
    for number, precision in ((1, 0.7), (2, 0.8), (3, 0.99)):
        register(number, precision)
    roll_back(registry, MODEL_NAME, "worse in the field")
    register(4)
    _, bar = rivals_of(4)
    assert (bar.against, recorded(bar)) == (2, [1])
    promote(registry, registry.version(MODEL_NAME, 3), "it was the camera")
    _, bar = rivals_of(4)
    assert (bar.against, recorded(bar)) == (3, [1, 2])


@pytest.mark.parametrize("how", [{"robot": THREE_LINK}, {"kind": "path"}])
def test_a_champion_of_another_robot_or_kind_is_no_rival(register, rivals_of, how):
    register(1, 0.9)
    register(2, **how)
    assert rivals_of(2)[0] is None


def test_no_bundle_is_its_own_rival(registry, register, rivals_of, tiny):
    register(1, 0.9)
    same = tiny(1, TWO_LINK)
    registry.register(MODEL_NAME, same.folder, "another run", same.digest, {})
    digest, bar = rivals_of(2)
    assert (digest, recorded(bar), bar.against) == (None, [], 1)
    assert bar.notes == ("the champion, version 1, is this very bundle",)
