"""The protocol plans: its command line, figures of known runs, and a small real benchmark."""

import json

import numpy as np
import pandas as pd
import pytest

from cspace.errors import ConfigError, DatasetError, EvaluationError, SamplerError
from cspace.query import PlanQuery
from cspace.simulator import Split, Taken
from cspace.view_file import unpack_view
from cspace.worlds import examples
from cspace.worlds.spatial.arm import ready_rad
from inference_api.settings import PRETRAINED_FOLDER
from services.evaluator.benchmark import __main__ as command
from services.evaluator.benchmark.__main__ import make_request, parser, refuse_others
from services.evaluator.benchmark.arms import CONNECT, TRUE_PATHS, Protocol, Setting, plan_arms
from services.evaluator.benchmark.figures import safety_figure
from services.evaluator.benchmark.job import run_benchmark
from services.evaluator.benchmark.plans import NO_PROBLEM, PlanWorker, plan_units
from services.evaluator.benchmark.report import plan_sections
from services.evaluator.benchmark.runs import PLAN_COLUMNS, RUNS, frame_of
from services.evaluator.benchmark.sources import PlanModel, SourceSpec
from services.evaluator.benchmark.summary import HARD, confidence_curve, summarise_plans
from tests.fakes.benchmark import run_here
from tests.fakes.registry import FakeTracking
from tests.inference_api.server import api_server
from tests.space_bundle import write_space_bundle

PLANS = ("--protocol", "plans", "--robot", "panda")
SMALL = (*PLANS, "--family", "motionbench_table_pick", "--problems", "2", "--pictures", "1", "--runs", "1")
FREE, KNOWN = Taken.FREE.value, Taken.KNOWN.value
SOURCE, EASY, HARDER = "MotionBenchMaker", "motionbench_table_pick", "motionbench_cage"
PATHS = "RRT-Connect, paths of model"
SETTING = Setting(Protocol.PLANS, Split.VALIDATION, 0, 1000, 1000, 20.0, world=examples()["panda"])
EMPTY = dict.fromkeys(PLAN_COLUMNS) | {
    "source": SOURCE, "family": EASY, "run": 0, "search_s": 0.0, "score_s": 0.0, "request_s": 0.0,
}  # fmt: skip


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """Searches that a busy machine does not cut off."""
    monkeypatch.setattr("services.evaluator.benchmark.__main__.PLAN_LIMIT_S", 10.0)


def options(tmp_path, *given):
    return parser().parse_args(["--out", str(tmp_path / "out"), *PLANS, *given])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ((), "no model plans"),
        (("--model", "m@champion"), "behind an API"),
        (("--bundle", "m=x", "--bundle", "m=y"), "share a name"),
        (("--bundle", "unseen is free=x"), "share a name"),
        (("--bundle", "m=x", "--pictures", "5"), "--pictures"),
        (("--bundle", "m=x", "--problems", "0"), "--problems"),
        (("--bundle", "m=x", "--time-limit", "0"), "--time-limit"),
        (("--bundle", "m=x", "--family", "narrow"), "no such family"),
        (("--bundle", "m=x", "--robot", "two-link"), "seen in part"),
        (("--bundle", "m=x", "--robot", "ur5", "--family", "motionbench_cage"), "no such family"),
        (("--bundle", "m=x", "--held", "--family", "motionbench_cage"), "no such family"),
        (("--bundle", "m=x", "--held", "--robot", "ur5"), "problems of a table"),
        (("--bundle", f"m={PRETRAINED_FOLDER}"), "does not plan for this robot"),
    ],
)
def test_a_wrong_request_is_refused(tmp_path, given, words):
    with pytest.raises(ConfigError, match=words):
        make_request(options(tmp_path, *given))


def test_test_problems_need_their_folder(tmp_path):
    with pytest.raises(DatasetError, match="do not ship"):
        make_request(options(tmp_path, "--bundle", "m=x", "--split", "test"))


def test_options_of_another_protocol_are_refused(tmp_path, capsys):
    with pytest.raises(ConfigError, match="no such options") as refused:
        refuse_others(options(tmp_path, "--samples", "10"), parser())
    assert "--samples" in str(refused.value)
    given = ["--out", str(tmp_path), "--pictures", "1", "--no-mlflow"]
    assert command.main(given, {}) == 2
    assert "--pictures" in capsys.readouterr().err


@pytest.mark.slow
def test_a_request_holds_what_a_set_has_at_most(tmp_path):
    bundle = write_space_bundle(tmp_path / "bundle")
    given = ("--bundle", f"m={bundle}", "--family", "motionbench_cage", "--family", "shelf")
    request = make_request(options(tmp_path, *given))
    assert request.problems == {"motionbench_cage": 30, "shelf": 30}
    assert (request.pictures, request.repeats) == ((1, 2, 3), 3)
    assert make_request(options(tmp_path, *given, "--problems", "40")).problems["motionbench_cage"] == 30


@pytest.mark.slow
def test_a_model_is_told_what_the_arm_holds(tmp_path, monkeypatch):
    bundle, asked = write_space_bundle(tmp_path / "bundle"), []
    given = ("--bundle", f"m={bundle}", "--held", "--pictures", "1", "--runs", "1", "--problems", "1")
    request = make_request(options(tmp_path, *given))
    assert set(request.problems) == {"motionbench_table_pick", "motionbench_table_under_pick"}
    worker = PlanWorker(request.setting, request.specs)
    asking = PlanModel.plan
    monkeypatch.setattr(PlanModel, "plan", lambda *call: asked.append(call[1]) or asking(*call))
    (unit,) = [
        one.without({key for key in one.run_keys() if key[-1] not in ("m", FREE)})
        for one in request.units()
        if one.family == "motionbench_table_pick" and one.pictures
    ]
    rows = {row["arm"]: row for row in worker.run(unit)}
    assert rows["m"]["solved"]
    assert rows[FREE]["solved"]
    known = json.loads(unpack_view(asked[0]).known)
    assert [len(known[name]) for name in ("scene", "attached")] == [1, 1]
    assert rows["m"]["meshes_free"] is None


def test_only_missing_runs_are_done():
    units = list(plan_units({"shelf": 2}, (1,), 2, plan_arms(["m"])))
    assert [(unit.index, unit.pictures) for unit in units] == [(0, 0), (0, 1), (1, 0), (1, 1)]
    keys = {key for unit in units for key in unit.run_keys()}
    # Six arms without checks; three with them, twice each.
    assert len(keys) == 2 * (6 + 3 * 2)
    lacking = keys - {("shelf", 1, 1, 1, "RRT-Connect, paths of m")}
    ((arm, run),) = [one for unit in units for one in unit.without(lacking).todo]
    assert (arm.name, run) == ("RRT-Connect, paths of m", 1)


def planned(arm: str, problem: int, clearance_m: float | None, **values) -> dict:
    """A path without exact checks; without a clearance there is none."""
    solved = clearance_m is not None
    found = {
        "arm": arm, "problem": problem, "checked": False, "pictures": 0 if arm == KNOWN else 1,
        "sampler": "model" if arm == "model" else None, "status": "solved" if solved else "refused",
        "solved": solved, "clearance_m": clearance_m, "search_s": 0.1, "request_s": 0.2,
    }  # fmt: skip
    return EMPTY | found | values


def searched(arm: str, problem: int, states: int, *, solved: bool = True, **values) -> dict:
    """A search with exact checks."""
    model = "model" if "model" in arm else None
    found = {
        "arm": arm, "problem": problem, "checked": True, "pictures": 1 if model else 0, "sampler": model,
        "status": "solved" if solved else "the time limit was reached", "solved": solved, "as_is": False,
        "state_checks": states, "edge_checks": states // 10, "iterations": states // 20,
        "solve_s": 2e-6 * states, "state_check_s": 1e-6, "length_rad": 4.0 if solved else None,
    }  # fmt: skip
    return EMPTY | found | values


ARMS = plan_arms(["model"])
GROUP = f"{SOURCE}, 1"


def summarised(rows):
    return summarise_plans(frame_of(rows, Protocol.PLANS), (1,), ARMS, SETTING)


def by_arm(rows, group=GROUP):
    found = summarised(rows)
    own = found[found["family"] == group]
    return {name: one.set_index("measure") for name, one in own.groupby("arm")}


def sections(rows):
    runs = frame_of(rows, Protocol.PLANS)
    found = plan_sections(summarise_plans(runs, (1,), ARMS, SETTING), runs, (1,), ARMS, SETTING)
    return {heading.partition(":")[0]: table for heading, _, table in found}


@pytest.fixture
def four():
    """Four problems: the model's paths by confidence free, free, 5 mm deep, and none."""
    sure = {0: (0.9, 0.01), 1: (0.8, 0.02), 2: (0.2, -0.005)}
    model = [planned("model", at, depth, confidence=value) for at, (value, depth) in sure.items()]
    free = [planned(FREE, at, -0.02, unseen=0.4 + 0.2 * at) for at in range(3)]
    known = [planned(KNOWN, at, 0.01) for at in range(4)]
    return [*model, planned("model", 3, None), *free, planned(FREE, 3, 0.03, unseen=0.995), *known]


def test_shares_are_of_problems_and_of_paths(four):
    found = by_arm(four)
    model, free = found["model"]["value"], found[FREE]["value"]
    assert (model["solved"], model["refused"], model["deep"]) == (0.75, 0.25, 0.0)
    assert found["model"].loc["collide", ["value", "count"]].tolist() == [pytest.approx(1 / 3), 3]
    assert (free["collide"], free["deep"]) == (0.75, 0.75)
    assert (model["search_ms_median"], model["search_ms_p95"]) == pytest.approx((100.0, 100.0))


def test_the_difference_to_unseen_free_is_over_problems_that_both_solve(four):
    found = by_arm(four)
    assert found["model"].loc["more", ["value", "count"]].tolist() == [pytest.approx(1 / 3 - 1.0), 3]
    assert found[KNOWN].loc["more", "value"] == -0.75
    assert "more" not in found[FREE].index


def test_the_report_says_where_meshes_were_not_checked(four):
    table = sections(four)["Without exact checks"].set_index("arm")
    assert table.loc["model", "by meshes"] == "not checked"
    looked = [planned(FREE, at, 0.01, meshes_free=at > 0) for at in range(4)]
    assert by_arm(looked)[FREE].loc["meshes", "value"] == 0.25


def test_only_the_surest_paths_are_answers_at_a_higher_confidence(four):
    runs = frame_of([row for row in four if row["arm"] == "model"], Protocol.PLANS)
    curve = confidence_curve(runs)
    np.testing.assert_allclose(curve["answered"], [0.25, 0.5, 0.75])
    np.testing.assert_allclose(curve["collide"], [0.0, 0.0, 1 / 3])
    np.testing.assert_allclose(curve["confidence"], [0.9, 0.8, 0.2])
    model = by_arm(four)["model"]
    # 0.1, 0.2 and 0.2 away from the truth.
    assert model.loc["calibration_error", "value"] == pytest.approx(0.5 / 3)
    assert model.loc["surer_half_collide", ["value", "count"]].tolist() == [0.0, 1]
    rows = sections(four)["By min_confidence"].to_numpy().tolist()
    assert rows[1:2] == [["model", "0.6", "0.50", "0.800", "0.000"]]
    assert rows[-1] == ["model", "1.0", "0.75", "0.200", "0.333"]


def test_problems_are_those_that_all_arms_have_run_and_whose_ends_are_free(four):
    bad = [planned(arm, 4, None, status=NO_PROBLEM) for arm in ("model", FREE, KNOWN)]
    half = [planned("model", 5, 0.01, confidence=0.5)]
    assert by_arm([*four, *bad, *half])["model"].loc["solved", "count"] == 4
    with pytest.raises(EvaluationError, match="all arms"):
        summarised([*half, planned(FREE, 4, 0.1)])


def test_collisions_by_family_and_by_unseen_share(four):
    assert by_arm(four, f"{EASY}, 1")["model"].loc["collide", "count"] == 3
    found = sections(four)
    assert found["Collisions by family"].to_dict("records") == [
        {"family": EASY, "model": "0.33 (3)", FREE: "0.75 (4)", KNOWN: "0.00 (4)"}
    ]
    bins = found["Collisions by unseen share"].set_index("unseen")
    assert bins[FREE].to_dict() == {
        "0.00 to 0.50": "1.00 (1)",
        "0.50 to 0.80": "1.00 (1)",
        "0.80 to 0.95": "1.00 (1)",
        "0.99 to 1.00": "0.00 (1)",
    }
    assert (bins[KNOWN] == "-").all()


def test_without_paths_nothing_is_said_of_confidence():
    rows = [planned("model", 0, None), planned(FREE, 0, None)]
    assert set(by_arm(rows)["model"].index) & {"collide", "calibration_error", "more"} == set()
    assert set(sections(rows)) == {"Without exact checks", "Collisions by family"}


def test_the_figure_has_a_curve_for_the_model_and_a_mark_for_the_others(four):
    (axes,) = safety_figure(frame_of(four, Protocol.PLANS), (1,), ARMS, SETTING).axes
    curve, *marks = axes.get_lines()
    np.testing.assert_allclose(curve.get_ydata(), [0.0, 0.0, 1 / 3])
    assert [tuple(mark.get_xydata()[0]) for mark in marks] == [(1.0, 0.75), (1.0, 0.0)]


@pytest.fixture
def searches():
    """Three problems: uniform 100, 200, 1000 states; with paths 50, 100, 100 and 10 ms for them."""
    uniform = [searched(CONNECT.name, at, states) for at, states in enumerate((100, 200, 1000))]
    paths = [
        searched(PATHS, at, states, request_s=0.01, as_is=at == 0, length_rad=2.0)
        for at, states in enumerate((50, 100, 100))
    ]
    return [*uniform, *paths]


def test_exact_checks_have_median_p90_and_ratios(searches):
    found = by_arm(searches)
    paths = found[PATHS]["value"]
    assert (paths["state_checks_median"], paths["state_checks_p90"]) == (100, 100)
    # Over uniform's 200 and, between 200 and 1000, 840.
    assert [paths[f"states_ratio_{name}"] for name in ("median", "p90")] == pytest.approx([0.5, 100 / 840])
    assert paths["as_is"] == pytest.approx(1 / 3)
    assert paths["length_ratio"] == 0.5
    assert "states_ratio_median" not in found[CONNECT.name].index


def test_the_price_from_which_on_paths_save_time_is_where_the_lines_cross(searches):
    found = by_arm(searches)[PATHS].loc["break_even_state_base_from_us", "value"]
    # Half of what a search takes are its checks: 30 ms and 0.25 ms against 1.3 ms, and 1050 states fewer.
    assert found == pytest.approx(1e6 * (0.03025 - 0.0013) / 1050)


def test_times_are_given_at_the_prices_of_spheres_and_of_meshes(searches):
    paths = by_arm(searches)[PATHS]["value"]
    assert paths["spheres_ms"] == pytest.approx(10.0 + 0.2)
    assert "meshes_ms" not in paths.index
    dear = [searched(arm, 0, 100, mesh_check_s=1e-5) for arm in (CONNECT.name, PATHS)]
    assert by_arm(dear)[PATHS].loc["meshes_ms", "value"] == pytest.approx(0.1 + 1.0)


def test_a_problem_that_is_not_solved_ranks_behind_all_others():
    uniform = [searched(CONNECT.name, at, 100) for at in range(3)]
    paths = [searched(PATHS, 0, 10, solved=False), *(searched(PATHS, at, 50) for at in (1, 2))]
    found = by_arm([*uniform, *paths])[PATHS]
    assert np.isinf(found.loc["state_checks_p90", "high"])
    assert found.loc["solved", "value"] == pytest.approx(2 / 3)
    # Cut off, it counts as much as the largest of both, 100.
    assert found.loc["states_ratio_p90", "value"] == pytest.approx(0.9)


def test_of_the_runs_of_a_problem_the_median_counts_and_missing_ones_are_waited_for():
    runs = [
        searched(arm, at, states, run=run)
        for arm in (CONNECT.name, PATHS)
        for at in (0, 1)
        for run, states in enumerate((10, 20, 900))
    ]
    found = by_arm(runs)[CONNECT.name]
    assert found.loc["state_checks_p90", ["value", "count"]].tolist() == [20, 2]
    assert by_arm(runs[:-1])[CONNECT.name].loc["state_checks_p90", "count"] == 1


def test_groups_are_all_problems_the_hard_ones_and_every_family(searches):
    others = [searched(arm, 0, 10, family=HARDER) for arm in (CONNECT.name, PATHS)]
    table = sections([*searches, *others])["With exact checks"]
    assert table["problems"].unique().tolist() == [
        f"{SOURCE} (4)", f"{SOURCE}, {HARD} (1)", f"{HARDER} (1)", f"{EASY} (3)",
    ]  # fmt: skip


@pytest.mark.slow
def test_a_benchmark_of_plans_leaves_its_files_and_goes_on_where_it_was_stopped(tmp_path):
    bundle, out, lines = write_space_bundle(tmp_path / "bundle"), tmp_path / "out", []
    request = make_request(options(tmp_path, "--bundle", f"tiny={bundle}", *SMALL))
    tracking = FakeTracking()

    def stopped(*args):
        yield next(run_here(*args))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_benchmark(request, stopped, lines.append)
    kept = (out / RUNS).read_text()
    results = run_benchmark(request, run_here, lines.append, tracking)
    assert (out / RUNS).read_text().startswith(kept)
    assert any("3 views of problems to do" in line for line in lines)
    files = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    assert files - {".gitignore"} == {
        "manifest.json",
        "report.md",
        "runs.parquet",
        RUNS,
        "figures/safety.png",
    }
    frame = pd.read_parquet(out / "runs.parquet").set_index(["arm", "problem"])
    assert len(frame) == 2 * (6 + 3)
    known = frame.loc[Taken.KNOWN.value]
    assert known["solved"].all()
    assert (known["clearance_m"] > -0.005).all()
    paths = frame.loc[TRUE_PATHS.name]
    assert paths["solved"].all()
    assert (paths["state_checks"] < frame.loc[CONNECT.name]["state_checks"].max()).all()
    assert not frame.loc[Taken.OCCUPIED.value]["solved"].any()
    report = (out / "report.md").read_text()
    for words in ("![safety](figures/safety.png)", "## With exact checks: 1 picture", "35 us", "| tiny |"):
        assert words in report
    (run,) = tracking.runs.values()
    assert run.status == "FINISHED"
    assert run.params["samplers.tiny"] == request.specs[0].digest
    assert "MotionBenchMaker_1/tiny/solved" in run.history
    assert run.tags["mlflow.note.content"] == report.partition("\n")[0]
    again = run_benchmark(request, None, lines.append)
    pd.testing.assert_frame_equal(again.runs, results.runs)


@pytest.mark.e2e
@pytest.mark.slow
def test_a_model_behind_the_api_plans_as_its_bundle_does(tmp_path):
    # A family of the project's own: MotionBenchMaker's has limits that a served model does not know.
    small = (*PLANS, "--family", "table", "--problems", "2", "--pictures", "1", "--runs", "1")
    bundle, out = write_space_bundle(tmp_path / "bundle"), tmp_path / "out"
    with api_server(tmp_path, {"CSPACE_PRETRAINED_MODEL": str(bundle)}) as url:
        given = [
            "--out", str(out), "--api", url, "--model", "there=pretrained", "--bundle", f"here={bundle}",
            *small, "--processes", "1", "--no-mlflow",
        ]  # fmt: skip
        assert command.main(given, {}) == 0
    described = json.loads((out / "manifest.json").read_text())["samplers"]["there"]
    assert (described["model"], described["transport"]) == ("pretrained", "HTTP")
    frame = pd.read_parquet(out / "runs.parquet").set_index(["arm", "problem"])
    there, here = frame.loc["there"], frame.loc["here"]
    assert (there["status"] == here["status"]).all()
    np.testing.assert_allclose(there["length_rad"], here["length_rad"], rtol=1e-5)


def test_another_model_than_the_pinned_one_is_refused():
    class Client:
        def plan(self, picture, query, model):
            head = type("Head", (), {"digest": "b" * 64})
            return type("Found", (), {"model": head, "round_trip_s": 0.1})

    world = examples()["panda"]
    planner = PlanModel(SourceSpec("m", "a" * 64, with_ends=True), Client(), world.space)
    ready = tuple(ready_rad(world.body).tolist())
    with pytest.raises(SamplerError, match="another model answers for m"):
        planner.plan(b"", PlanQuery(ready, ready), world)
    beyond = (*ready[:3], -3.1, *ready[4:])
    plan, _ = planner.plan(b"", PlanQuery(ready, beyond), world)
    assert plan.status == "refused"
