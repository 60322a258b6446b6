"""The pictures of single scenarios: which are shown and what is marked on them."""

import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.simulator import Split
from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK, PlanarArm
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.problems import Family
from cspace.worlds.planar.world import PlanarWorld
from inference_api.settings import further_folders
from services.evaluator.evaluation import Evaluation, table_of
from services.evaluator.figures import MISSED_COLOUR, SHOWN_SAMPLES, completions, gallery
from services.evaluator.measure import QUICK, Row, Setting, Unit, UnitResult
from services.evaluator.metrics import Task
from services.evaluator.report import exhibits
from services.evaluator.scenes import Scene, Stage
from tests.fakes.sample_source import FakeSampleSource
from tests.fakes.uniform_sampler import UniformSampler

STAGE = Stage(PlanarWorld(TWO_LINK, Camera()), Split.TEST, 0)


def measured(family, *precisions):
    return [
        Row(Task.RECONSTRUCTION, str(family), number, 0, "sampler", "precision", 0, value)
        for number, value in enumerate(precisions)
    ]


def evaluation_of(rows):
    done = UnitResult(Unit(Task.RECONSTRUCTION, Split.TEST, 0, 1), rows, 0.0)
    return Evaluation(Setting(STAGE.world, 0, QUICK), "m/1", table_of([done], "m/1"), 0.0)


def marked(axes, colour):
    """How many points of a colour a panel holds."""
    from matplotlib.colors import to_rgba

    return sum(
        len(points.get_offsets())
        for points in axes.collections
        if np.allclose(points.get_facecolor()[:1], to_rgba(colour))
    )


@pytest.mark.parametrize("robot", [PlanarArm((2.5,)), TWO_LINK, THREE_LINK])
def test_the_gallery_has_three_panels_a_scenario(robot, tmp_path):
    stage = Stage(PlanarWorld(robot, Camera()), Split.TEST, 0)
    figure = gallery([Scene(stage, 0), Scene(stage, 1)], UniformSampler(robot.space), "two scenarios")
    figure.savefig(tmp_path / "gallery.png")
    assert len(figure.axes) == 6
    assert (tmp_path / "gallery.png").stat().st_size > 10_000
    assert "free" in figure.axes[2].get_title()


def test_what_a_model_expects_is_drawn_from_the_side_among_the_obstacles():
    bundle = Bundle.load(further_folders()["pretrained-panda"], check=False)
    scene = Scene(Stage(bundle.spec.world, Split.VALIDATION, 0), 0)
    _, panel, _ = completions([scene], bundle, "one").axes
    (image,), found = panel.images, bundle.belief(scene.image)
    np.testing.assert_array_equal(image.get_array(), found.occupied.max(axis=1).T)
    (left, _, low), (x, _, z) = found.low_m, found.cell_m * np.array(found.occupied.shape)
    assert image.get_extent() == pytest.approx([left, left + x, low, low + z])
    obstacles = scene.scenario.obstacles
    assert len(panel.patches) == len(obstacles.boxes) + len(obstacles.cylinders)


def test_free_configurations_that_no_sample_is_near_are_marked():
    scene = Scene(STAGE, 0)
    collapsed = FakeSampleSource(lambda rng, n: np.tile(scene.free(1, scene.rng(0)), (n, 1)))
    panel = gallery([scene], collapsed, "collapsed").axes[2]
    assert "100.0% free" in panel.get_title()
    assert 0.95 * SHOWN_SAMPLES < marked(panel, MISSED_COLOUR) < SHOWN_SAMPLES


def test_a_problem_s_ends_and_its_passage_are_shown_with_the_note():
    scene = Scene(STAGE, 0, Family.DISCONNECTED)
    figure = gallery([scene], UniformSampler(TWO_LINK.space), "one", ["least precise of 3"])
    picture, truth, _ = figure.axes
    assert picture.get_title() == "test, disconnected scenario 0\nleast precise of 3"
    assert truth.get_title().endswith("no path")
    assert np.array_equal(truth.collections[0].get_offsets(), [scene.problem.start, scene.problem.goal])


def test_the_first_scenarios_and_the_least_precise_of_every_family_are_exhibits():
    rows = [
        *measured(Family.UNIFORM, 0.9, 0.8, 0.7, 0.6, 0.65),
        *measured(Family.NARROW, 0.5, 0.4),
        *measured(Family.DISCONNECTED, 0.3),
    ]
    assert exhibits(STAGE, evaluation_of(rows)) == {
        Scene(STAGE, 0): "",
        Scene(STAGE, 1): "",
        Scene(STAGE, 3): "least precise of 5",
        Scene(STAGE, 1, Family.NARROW): "least precise of 2",
        Scene(STAGE, 0, Family.DISCONNECTED): "least precise of 1",
    }
    # A scenario is shown once.
    rows = measured(Family.UNIFORM, 0.9, 0.2, 0.7)
    assert exhibits(STAGE, evaluation_of(rows)) == {
        Scene(STAGE, 0): "",
        Scene(STAGE, 1): "least precise of 3",
    }
