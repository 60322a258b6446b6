"""Whom a candidate is measured beside: champions of its robot and the shipped model, no more than three."""

import pytest

from cspace.bundle import Bundle
from cspace.errors import ConfigError, ModelNotFoundError, RegistryUnavailableError
from cspace.worlds import robot_digest
from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK, PlanarArm
from cspace.worlds.planar.world import PlanarWorld
from inference_api.settings import PRETRAINED_FOLDER
from services.evaluator.evaluation.rivals import find_rivals
from services.names import MODEL_NAME
from services.registry.promotion import Decision, promote, record_decision, roll_back
from tests.bundles import write_tiny_bundle
from tests.fakes.registry import FakeRegistry

TWO, THREE, OTHER_TWO = PlanarWorld(), PlanarWorld(THREE_LINK), PlanarWorld(PlanarArm((1.0, 3.0)))


@pytest.fixture
def registry(tmp_path):
    return FakeRegistry(tmp_path / "registry")


@pytest.fixture
def register(registry, tmp_path):
    """Registers a tiny bundle of its own, promoted with a precision where one is given; the bundle."""

    def add(number, precision=None, robot=TWO_LINK, **how):
        bundle = Bundle.load(
            write_tiny_bundle(tmp_path / f"bundle-{number}", robot, scale=1.0 + number, **how)
        )
        assert registry.register(MODEL_NAME, bundle.folder, "run", bundle.digest, {}).number == number
        if precision is not None:
            metrics = {"precision": precision}
            digest = robot_digest(PlanarWorld(robot))
            told = Decision(
                MODEL_NAME,
                number,
                promoted=True,
                reasons=("made",),
                metrics=metrics,
                against=None,
                created_ms=number,
                robot=digest,
            )
            record_decision(registry, told)
        return bundle

    return add


def names(field):
    return [rival.name for rival in field.rivals]


def test_the_present_champion_and_the_best_before_it_are_measured_and_the_others_recorded(
    registry, register, tmp_path
):
    for number, precision in ((1, 0.8), (2, 0.9), (3, 0.7), (4, 0.85)):
        register(number, precision)
    field = find_rivals(registry, *candidate(registry, register, 5), None, tmp_path / "rivals")
    assert names(field) == ["version 4, the present champion", "version 2, the best before it"]
    assert [champion.version for champion in field.recorded] == [1, 3]
    assert field.against == 4
    assert field.notes == ("not compared with the shipped model, as was asked for",)


def candidate(registry, register, number, **how):
    bundle = register(number, **how)
    return registry.version(MODEL_NAME, number), bundle


def test_a_champion_whose_bundle_is_gone_is_compared_by_its_record_which_is_said(
    registry, register, tmp_path
):
    register(1, 0.8)
    version, bundle = candidate(registry, register, 2)
    registry.download = fails_for(1, registry.download)
    field = find_rivals(registry, version, bundle, None, tmp_path / "rivals")
    assert (names(field), [one.version for one in field.recorded], field.against) == ([], [1], 1)
    assert "version 1, the present champion, can not be measured again" in field.notes[0]


def fails_for(number, download):
    def failing(version, folder):
        if version.number == number:
            raise ModelNotFoundError("its bundle is gone")
        return download(version, folder)

    return failing


def test_a_registry_that_goes_away_ends_the_search(registry, register, tmp_path):
    register(1, 0.8)
    version, bundle = candidate(registry, register, 2)
    registry.away = True
    with pytest.raises(RegistryUnavailableError):
        find_rivals(registry, version, bundle, None, tmp_path / "rivals")


def test_a_champion_that_was_deleted_is_no_rival(registry, register, tmp_path):
    register(1, 0.9)
    register(2, 0.8)
    registry.delete(MODEL_NAME, 1)
    field = find_rivals(registry, *candidate(registry, register, 3), None, tmp_path / "rivals")
    assert (names(field), field.recorded) == (["version 2, the present champion"], ())


def test_a_version_that_was_rolled_back_is_no_bar_any_more(registry, register, tmp_path):
    for number, precision in ((1, 0.7), (2, 0.8), (3, 0.99)):
        register(number, precision)
    roll_back(registry, MODEL_NAME, "worse in the field")
    version, bundle = candidate(registry, register, 4)
    field = find_rivals(registry, version, bundle, None, tmp_path / "rivals")
    assert names(field) == ["version 2, the present champion", "version 1, the best before it"]
    assert field.recorded == ()
    (note,) = (note for note in field.notes if "version 3" in note)
    assert note.startswith("not compared with version 3, which was rolled back on 20")
    promote(registry, registry.version(MODEL_NAME, 3), "it was the camera")
    again = find_rivals(registry, version, bundle, None, tmp_path / "again")
    assert names(again) == ["version 3, the present champion", "version 2, the best before it"]


def test_the_present_champion_is_a_rival_whatever_was_said_of_it(registry, register, tmp_path):
    for number in (1, 2):
        register(number, 0.8)
    roll_back(registry, MODEL_NAME, "worse in the field")
    registry.set_alias(MODEL_NAME, "champion", 2)
    field = find_rivals(registry, *candidate(registry, register, 3), None, tmp_path / "rivals")
    assert names(field) == ["version 2, the present champion", "version 1, the best before it"]
    assert not any("rolled back" in note for note in field.notes)


def test_an_alias_that_somebody_moved_makes_a_champion_as_well(registry, register, tmp_path):
    register(1)
    registry.set_alias(MODEL_NAME, "champion", 1)
    field = find_rivals(registry, *candidate(registry, register, 2), None, tmp_path / "rivals")
    assert (names(field), field.against) == (["version 1, the present champion"], 1)


def test_champions_of_other_robots_are_no_rivals(registry, register, tmp_path):
    register(1, 0.9, THREE_LINK)
    field = find_rivals(registry, *candidate(registry, register, 2), None, tmp_path / "rivals")
    assert (field.rivals, field.recorded, field.against) == ((), (), None)


def test_the_shipped_model_is_a_rival_of_its_robot_and_kind_alone(registry, register, tmp_path):
    for number, how, expected in (
        (1, {}, ["the shipped model"]),
        (2, {"robot": THREE_LINK}, []),
        (3, {"kind": "path"}, []),
    ):
        field = find_rivals(
            registry, *candidate(registry, register, number, **how), PRETRAINED_FOLDER, tmp_path / "rivals"
        )
        assert names(field) == expected
        assert (field.notes == ("no model of this robot and kind is shipped",)) is (not expected)


def test_no_bundle_is_its_own_rival_or_one_twice(registry, register, tmp_path):
    shipped = register(1, 0.9)
    again = Bundle.load(shipped.folder)
    registry.register(MODEL_NAME, again.folder, "another run", again.digest, {})
    field = find_rivals(registry, registry.version(MODEL_NAME, 2), again, shipped.folder, tmp_path / "rivals")
    assert field.rivals == ()
    assert field.notes[-1] == "the shipped model, is this very bundle"
    other = find_rivals(registry, *candidate(registry, register, 3), shipped.folder, tmp_path / "more")
    assert names(other) == ["version 1, the present champion"]


def test_a_shipped_model_that_is_not_there_is_an_error_that_names_the_option(registry, register, tmp_path):
    version, bundle = candidate(registry, register, 1)
    with pytest.raises(ConfigError, match="--without-shipped"):
        find_rivals(registry, version, bundle, tmp_path / "nothing", tmp_path / "rivals")
