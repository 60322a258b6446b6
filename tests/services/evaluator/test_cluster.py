from pathlib import Path

import pytest

from cspace.bundle import Bundle
from cspace.simulator import Split
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.problems import Family
from cspace.worlds.planar.world import PlanarWorld
from services.evaluator.evaluation import QUICK, Evaluation, Setting, Unit, table_of
from services.evaluator.job import run_here, run_on_ray
from services.evaluator.metrics import Task
from services.evaluator.scenes import PackedBundle
from tests.bundles import write_tiny_bundle

ROOT = Path(__file__).resolve().parents[3]
WORK = (
    Unit(Task.PLANNING, Split.VALIDATION, 0, 2, Family.UNIFORM),
    Unit(Task.PLANNING, Split.VALIDATION, 2, 2, Family.UNIFORM),
    Unit(Task.RECONSTRUCTION, Split.VALIDATION, 0, 2),
    Unit(Task.RECONSTRUCTION, Split.TEST, 0, 2),
)


@pytest.fixture(scope="module")
def cluster():
    import ray

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patch.setenv("RAY_AUTH_MODE", "disabled")
        patch.delenv("RAY_ADDRESS", raising=False)
        ray.init(
            num_cpus=2,
            include_dashboard=False,
            _node_ip_address="127.0.0.1",
            log_to_driver=False,
            runtime_env={"env_vars": {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}},
        )
        yield
        ray.shutdown()


@pytest.fixture
def packed(tmp_path):
    return PackedBundle.pack(Bundle.load(write_tiny_bundle(tmp_path / "bundle")))


def numbers(results, setting):
    return Evaluation(setting, "m/1", table_of(list(results), "m/1"), 0.0).estimates.to_csv()


@pytest.mark.e2e
def test_a_cluster_gives_the_same_numbers_as_this_process(cluster, packed):
    setting = Setting(PlanarWorld(TWO_LINK, Camera()), 4, QUICK)
    here = numbers(run_here(WORK, setting, packed), setting)
    there = numbers(run_on_ray(WORK, setting, packed), setting)
    assert there == here
    assert "iterations_median" in here
