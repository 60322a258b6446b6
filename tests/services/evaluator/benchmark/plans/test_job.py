"""A small real benchmark of plans from its model to its files."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from cspace.errors import SamplerError
from cspace.planning.query import Plan, PlanQuery
from cspace.worlds import examples
from cspace.worlds.spatial.robot.ready import ready_rad
from cspace.worlds.unseen import Taken
from services.evaluator.benchmark import __main__ as command
from services.evaluator.benchmark.job import parser
from services.evaluator.benchmark.plans.job import make_plan_request, run_plans
from services.evaluator.benchmark.plans.measure import PlanWorker
from services.evaluator.benchmark.plans.planners import ServedPlanner
from services.evaluator.benchmark.plans.setting import BASE, TRUE_WAYS, PlanRun
from services.evaluator.benchmark.sources import SourceSpec
from services.evaluator.benchmark.store import RUNS, descriptions
from tests.fakes.registry import FakeTracking
from tests.inference_api.server import api_server
from tests.space_bundle import write_space_bundle

GIVEN = ("--protocol", "plans", "--robot", "panda", "--family", "motionbench_table_pick", "--problems", "2",
         "--pictures", "1", "--runs", "1")  # fmt: skip


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """Searches that a busy machine does not cut off."""
    monkeypatch.setattr("services.evaluator.benchmark.plans.job.PLAN_LIMIT_S", 10.0)


def work_here(work, setting, specs):
    worker = PlanWorker(setting, specs)
    for unit in work:
        yield worker.run(unit)


@pytest.mark.slow
def test_a_benchmark_of_plans_leaves_its_files_and_goes_on_where_it_was_stopped(tmp_path):
    bundle, out, lines = write_space_bundle(tmp_path / "bundle"), tmp_path / "out", []
    given = ["--out", str(out), "--bundle", f"tiny={bundle}", *GIVEN]
    request, tracking = make_plan_request(parser().parse_args(given)), FakeTracking()

    def stopped(*args):
        yield next(work_here(*args))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_plans(request, stopped, lines.append)
    kept = (out / RUNS).read_text()
    results = run_plans(request, work_here, lines.append, tracking)
    assert (out / RUNS).read_text().startswith(kept)
    assert any("3 views of problems to do" in line for line in lines)
    files = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    assert files == {"manifest.json", "report.md", "runs.parquet", RUNS, "figures/safety.png"}
    frame = pd.read_parquet(out / "runs.parquet").set_index(["arm", "problem"])
    assert len(frame) == 2 * (6 + 3)
    known = frame.loc[Taken.KNOWN.value]
    assert known["solved"].all()
    assert (known["clearance_m"] > -0.005).all()
    ways = frame.loc[TRUE_WAYS.name]
    assert ways["solved"].all()
    assert (ways["state_checks"] < frame.loc[BASE.name]["state_checks"].max()).all()
    assert not frame.loc[Taken.OCCUPIED.value]["solved"].any()
    report = (out / "report.md").read_text()
    for words in ("![safety](figures/safety.png)", "## With exact checks: 1 picture", "35 us", "| tiny |"):
        assert words in report
    (run,) = tracking.runs.values()
    assert run.status == "FINISHED"
    assert run.params["samplers.tiny"] == request.specs[0].digest
    assert "MotionBenchMaker_1/tiny/solved" in run.history
    assert run.tags["mlflow.note.content"] == report.partition("\n")[0]
    again = run_plans(request, None, lines.append)
    assert [one.key for one in again.runs] == [one.key for one in results.runs]
    # A number of pictures that was not asked for is not told of.
    assert not replace(request, pictures=(2,)).covers(results.plans[0].arms["tiny"][0])


@pytest.mark.e2e
@pytest.mark.slow
def test_a_model_behind_the_api_plans_as_its_bundle_does(tmp_path):
    bundle, out = write_space_bundle(tmp_path / "bundle"), tmp_path / "out"
    with api_server(tmp_path, {"CSPACE_PRETRAINED_MODEL": str(bundle)}) as url:
        given = [
            "--out", str(out), "--api", url, "--model", "there=pretrained", "--bundle", f"here={bundle}",
            *GIVEN, "--processes", "1", "--no-mlflow",
        ]  # fmt: skip
        assert command.main(given, {}) == 0
    told = json.loads((out / "manifest.json").read_text())["samplers"]["there"]
    assert (told["model"], told["transport"]) == ("pretrained", "HTTP")
    frame = pd.read_parquet(out / "runs.parquet").set_index(["arm", "problem"])
    there, here = frame.loc["there"], frame.loc["here"]
    assert (there["status"] == here["status"]).all()
    np.testing.assert_allclose(there["length_rad"], here["length_rad"], rtol=1e-5)


def test_another_model_than_the_pinned_one_is_refused():
    class Client:
        def plan(self, picture, query, model):
            head = type("Head", (), {"digest": "b" * 64})
            found = Plan("refused", np.empty((0, 7)))
            return type("Found", (), {"model": head, "plan": found, "round_trip_s": 0.1})

    world = examples()["panda"]
    planner = ServedPlanner(Client(), SourceSpec("m", "a" * 64, with_ends=True), world.space)
    ready = tuple(ready_rad(world.body).tolist())
    with pytest.raises(SamplerError, match="another model answers for m"):
        planner.plan(b"", PlanQuery(ready, ready), world)
    beyond = (*ready[:3], -3.1, *ready[4:])
    assert planner.plan(b"", PlanQuery(ready, beyond), world).plan.status == "refused"


def test_every_column_says_what_it_holds():
    assert all(descriptions(PlanRun).values())
