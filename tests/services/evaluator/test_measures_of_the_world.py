"""What is measured by, and what is told of it, are the world's numbers and not the evaluator's."""

from dataclasses import replace

import numpy as np
import pytest

from cspace.simulator import Split
from cspace.worlds import simulator_of
from cspace.worlds.planar.simulator import PlanarSimulator
from cspace.worlds.planar.world import PlanarWorld
from services.evaluator.benchmark.__main__ import make_request, parser
from services.evaluator.evaluation.report import gallery, to_json, to_markdown
from services.evaluator.evaluation.units import Budget, Kind, Setting, Unit, assemble, run_unit
from services.evaluator.measures.scenes import Scene, Stage
from tests.fakes.uniform_sampler import UniformSampler

PLANAR = simulator_of(PlanarWorld()).measures
OTHER = replace(PLANAR, coverage_radius_rad=0.7, near_contact_m=0.3, range_rad=0.4, resolution_rad=0.02)
SCENE = Scene(Stage(PlanarWorld(), Split.VALIDATION, 5), 0)
UNIFORM = UniformSampler(PlanarWorld().space)


@pytest.fixture
def other(monkeypatch):
    monkeypatch.setattr(PlanarSimulator, "measures", property(lambda _: OTHER))


def test_the_radius_of_coverage_is_the_worlds(other):
    held_out = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]] * 4)
    assert SCENE.quality(np.array([[0.5, 0.0]] * 6), held_out).coverage == pytest.approx(2 / 3)
    (legend,) = gallery([SCENE], UNIFORM, "uniform").legends
    assert "free, no sample within 0.7 rad" in [text.get_text() for text in legend.get_texts()]


def test_the_planner_of_an_evaluation_is_the_worlds(other):
    setting = Setting(PlanarWorld(), 5, Budget(1, 30, 1, 1, 1, 0, 1))
    work = [Unit(Kind.RECONSTRUCTION, split, 0, 1) for split in (Split.VALIDATION, Split.TEST)]
    work.append(Unit(Kind.PLANNING, Split.VALIDATION, 0, 1, "uniform"))
    done = assemble([run_unit(unit, setting, UNIFORM) for unit in work], setting)
    assert "RRT, range 0.4 rad, resolution 0.02 rad a joint" in to_markdown(done, "model", ())
    assert '"range_rad": 0.4' in to_json(done)


def test_the_planners_of_the_benchmark_are_the_worlds(other, tmp_path):
    request = make_request(parser().parse_args(["--out", str(tmp_path), "--variants", "uniform"]))
    settings = request.setting.planner(request.variants[0], 0, 0)
    assert (settings.range_rad, settings.resolution_rad) == (0.4, 0.02)
