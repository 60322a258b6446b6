import json
from dataclasses import replace

import pytest

from cspace.errors import EvaluationError, ModelNotFoundError, RegistryError
from cspace.worlds import simulator_of
from cspace.worlds.planar.arm import THREE_LINK
from cspace.worlds.planar.world import PlanarWorld
from services.evaluator import __main__ as command
from services.evaluator.evaluation.job import evaluate_version, executor, run_here, run_on_ray
from services.evaluator.evaluation.measured import MAX_HEADLINE, MAX_METRICS, flat_metrics
from services.evaluator.evaluation.units import Budget, Kind, make_request, units
from services.names import ALIAS_CHALLENGER, ALIAS_CHAMPION, MODEL_NAME
from services.registry.promotion import decisions
from tests.bundles import write_tiny_bundle
from tests.fakes.registry import FakeRegistry, FakeTracking

PROBLEMS = simulator_of(PlanarWorld()).families
TINY = Budget(
    scenarios=2,
    samples=150,
    validation_problems=0,
    test_problems=0,
    planner_seeds=1,
    topology_scenarios=1,
    draws=1,
    topology_samples=150,
)


def request(model=f"{MODEL_NAME}@{ALIAS_CHALLENGER}", *, promote=True):
    return replace(make_request(model, promote=promote), budget=TINY)


@pytest.fixture
def tracking():
    return FakeTracking()


@pytest.fixture
def registry(tmp_path, tracking):
    """A registry with one version, the challenger, made by the run of a training."""
    from cspace.bundle import Bundle

    store = FakeRegistry(tmp_path / "registry", tracking.runs)
    run = tracking.start(MODEL_NAME, "cluster-train")
    bundle = Bundle.load(write_tiny_bundle(tmp_path / "bundle"))
    store.register(MODEL_NAME, bundle.folder, run.run_id, bundle.digest, {}, alias=ALIAS_CHALLENGER)
    return store


def passing(monkeypatch):
    """Let the gate pass: the tiny model is no better than uniform, and the decision is not the point here."""
    from services.evaluator.evaluation import report

    judge = report.judge
    monkeypatch.setattr(report, "judge", lambda *given: replace(judge(*given), promoted=True))


def test_an_evaluation_is_a_child_of_the_training_with_metrics_report_and_pictures(tracking, registry):
    outcome = evaluate_version(request(), tracking, registry, progress=lambda line: None)
    run = tracking.runs[outcome.run_id]
    assert (run.name, run.status) == (f"{MODEL_NAME}/1 judged, seed 0, {run.run_id[:6]}", "FINISHED")
    assert run.parent_run_id == registry.version(MODEL_NAME, 1).run_id
    flat = flat_metrics(outcome.evaluation)
    assert run.history["validation/precision"][0][1] == flat["precision"]
    assert run.history["test/uniform_precision"][0][1] == flat["test_uniform_precision"]
    assert len(run.history) <= MAX_METRICS
    told = {"stage": "evaluation", "model_version": f"{MODEL_NAME}/1", "world": "planar, two-link"}
    assert told.items() <= run.tags.items()
    assert run.params["samples"] == str(outcome.evaluation.setting.budget.samples)
    assert b"\n\nJudged on scenes of the planar world with 3 discs" in run.artifacts["report/evaluation.md"]
    assert b"## Decision" in run.artifacts["report/evaluation.md"]
    assert json.loads(run.artifacts["report/evaluation.json"])["setting"]["seed"] == 0
    assert {f"figures/{name}.png" for name in outcome.figures} <= set(run.artifacts)


def test_every_estimate_stands_in_a_table_with_its_limits(tracking, registry):
    outcome = evaluate_version(request(), tracking, registry, progress=lambda line: None)
    table = json.loads(tracking.runs[outcome.run_id].artifacts["tables/measures.json"])
    rows = [dict(zip(table["columns"], row, strict=True)) for row in table["data"]]
    of = ("task", "split", "family", "sampler", "measure")
    found = {tuple(row[name] for name in of): row for row in rows}
    one, flat = (
        found["reconstruction", "test", "uniform", "uniform", "coverage"],
        flat_metrics(outcome.evaluation),
    )
    assert [one[name] for name in ("value", "low", "high")] == [
        flat[f"test_uniform_coverage{end}"] for end in ("", "_low", "_high")
    ]
    assert one["n"] == outcome.evaluation.setting.budget.scenarios
    assert len(found) == len(rows) == len({row["estimate"] for row in rows})
    assert one["shown"] == f"{one['value']:.4f} [{one['low']:.4f}, {one['high']:.4f}]"


def test_the_headline_is_shown_on_the_version_and_on_the_run_that_made_it(tracking, registry):
    outcome = evaluate_version(request(), tracking, registry, progress=lambda line: None)
    shown, version = registry.shown[MODEL_NAME, 1], registry.version(MODEL_NAME, 1)
    assert {"validation/precision", "test/coverage", "validation/edr"} <= set(shown.metrics)
    assert len(shown.metrics) <= MAX_HEADLINE
    made = tracking.runs[version.run_id].history
    assert {name: points[-1][1] for name, points in made.items()} == shown.metrics
    assert shown.note.startswith(f"## {MODEL_NAME}/1: not promoted")
    assert all(f"- {reason}" in shown.note for reason in outcome.verdict.reasons)
    assert tracking.runs[outcome.run_id].artifacts["report/comparison.md"].decode() == shown.note


def test_what_is_only_judged_is_not_shown(tracking, registry):
    evaluate_version(request(promote=False), tracking, registry, progress=lambda line: None)
    assert registry.shown == {}


def test_a_version_whose_training_was_deleted_is_judged_all_the_same(tracking, registry, monkeypatch):
    def gone(version, shown):
        raise RegistryError("there is no such run")

    monkeypatch.setattr(registry, "show", gone)
    lines = []
    outcome = evaluate_version(request(), tracking, registry, progress=lines.append)
    assert outcome.recorded
    assert lines[-1] == f"the figures are not shown with {MODEL_NAME}/1: there is no such run"


def test_a_refused_version_is_recorded_and_the_champion_stays(tracking, registry):
    outcome = evaluate_version(request(), tracking, registry, progress=lambda line: None)
    assert not outcome.verdict.promoted
    (decision,) = decisions(registry, MODEL_NAME)
    assert not decision.promoted
    assert decision.reasons == outcome.verdict.reasons
    assert set(decision.metrics) == {"precision", "coverage", "edr"}
    with pytest.raises(ModelNotFoundError):
        registry.by_alias(MODEL_NAME, ALIAS_CHAMPION)


def test_a_promoted_version_becomes_the_champion(tracking, registry, monkeypatch):
    passing(monkeypatch)
    evaluate_version(request(), tracking, registry, progress=lambda line: None)
    assert registry.by_alias(MODEL_NAME, ALIAS_CHAMPION).number == 1
    assert decisions(registry, MODEL_NAME)[0].promoted


def test_a_version_is_not_compared_with_its_own_earlier_promotion(tracking, registry, monkeypatch):
    passing(monkeypatch)
    for _ in range(2):
        outcome = evaluate_version(request(), tracking, registry, progress=lambda line: None)
    assert outcome.verdict.bar.against is None


def test_without_promotion_nothing_is_recorded(tracking, registry, monkeypatch):
    passing(monkeypatch)
    outcome = evaluate_version(request(promote=False), tracking, registry, progress=lambda line: None)
    assert not outcome.recorded
    assert decisions(registry, MODEL_NAME) == ()
    assert tracking.runs[outcome.run_id].status == "FINISHED"


def test_an_evaluation_that_fails_leaves_a_failed_run_and_no_decision(tracking, registry):
    def failing(work, setting, packed):
        raise EvaluationError("a unit failed")
        yield

    with pytest.raises(EvaluationError):
        evaluate_version(request(), tracking, registry, failing, lambda line: None)
    assert [run.status for run in tracking.runs.values()] == ["RUNNING", "FAILED"]
    assert decisions(registry, MODEL_NAME) == ()


def test_an_unknown_version_is_an_error(tracking, registry):
    with pytest.raises(ModelNotFoundError):
        evaluate_version(request(f"{MODEL_NAME}/9"), tracking, registry)


def test_a_path_model_is_not_judged_without_problems(tracking, registry, tmp_path):
    from cspace.bundle import Bundle

    bundle = Bundle.load(write_tiny_bundle(tmp_path / "path", THREE_LINK, kind="path"))
    run_id = tracking.start(MODEL_NAME, "cluster-train").run_id
    registry.register(MODEL_NAME, bundle.folder, run_id, bundle.digest, {})
    with pytest.raises(EvaluationError, match="path models are judged on uniform problems"):
        evaluate_version(request(f"{MODEL_NAME}/2"), tracking, registry)


def test_progress_tells_every_unit(tracking, registry):
    lines = []
    evaluate_version(request(), tracking, registry, progress=lines.append)
    assert len(lines) == 2 + len(units(TINY, PROBLEMS))
    assert f"{MODEL_NAME}/1" in lines[0]
    assert lines[1].startswith("judged on scenes of the planar world with 3 discs of radius 1.0 m (robot ")
    assert "2 validation and 2 test scenes of the family uniform" in lines[1]
    assert lines[1].endswith("seed 0")
    assert lines[-1].lstrip().startswith(f"{len(units(TINY, PROBLEMS))}/{len(units(TINY, PROBLEMS))}")


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({}, run_here),
        ({"RAY_ADDRESS": ""}, run_here),
        ({"RAY_ADDRESS": "http://127.0.0.1:8265"}, run_here),
        ({"RAY_ADDRESS": "127.0.0.1:6379"}, run_on_ray),
        ({"RAY_ADDRESS": "auto"}, run_on_ray),
    ],
)
def test_the_cluster_is_used_where_a_driver_can_reach_one(environment, expected):
    assert executor(environment) is expected


def test_the_command_prints_the_tables_a_block_and_a_result_line(
    tracking, registry, monkeypatch, capsys, tmp_path
):
    monkeypatch.setattr(command, "MlflowTracking", lambda uri: tracking)
    monkeypatch.setattr(command, "MlflowRegistry", lambda uri: registry)
    monkeypatch.setattr(command, "make_request", lambda *given, **options: request(promote=False))
    data = tmp_path / "data"
    environment = {"MLFLOW_TRACKING_URI": "http://127.0.0.1:1", "CSPACE_DATA_DIR": str(data)}
    assert command.main([], environment) == 0
    *lines, last = capsys.readouterr().out.splitlines()
    told = json.loads(last.removeprefix("RESULT "))
    assert (told["model"], told["version"], told["promoted"]) == (MODEL_NAME, 1, False)
    assert told["metrics"]["real_precision"] == 1.0
    assert any(line.startswith("not promoted") for line in lines)
    assert told["judged_on"] in lines
    kept = data / "jobs" / told["run_id"] / "result.json"
    assert json.loads(kept.read_text()) == told
    block = lines[lines.index("result") :]
    assert block[1] == f"  model     {MODEL_NAME}/1, digest {told['digest'][:12]}"
    assert block[2:4] == ["  promoted  no", f"  run       {told['run_id']}"]
    assert block[-1] == f"  as JSON   {kept}"


@pytest.mark.parametrize("environment", [{}, {"CSPACE_DATA_DIR": ""}, {"CSPACE_DATA_DIR": "here"}])
def test_without_a_data_folder_the_result_is_the_line_alone(
    environment, tracking, registry, monkeypatch, capsys, tmp_path
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "MlflowTracking", lambda uri: tracking)
    monkeypatch.setattr(command, "MlflowRegistry", lambda uri: registry)
    monkeypatch.setattr(command, "make_request", lambda *given, **options: request(promote=False))
    assert command.main([], {"MLFLOW_TRACKING_URI": "http://127.0.0.1:1", **environment}) == 0
    printed = capsys.readouterr().out
    assert printed.splitlines()[-1].startswith("RESULT {")
    assert "as JSON" not in printed
    assert not (tmp_path / "here").exists()
    assert not (tmp_path / "jobs").exists()


@pytest.mark.parametrize(
    ("arguments", "environment"),
    [
        (["--model", "nothing"], {"MLFLOW_TRACKING_URI": "http://127.0.0.1:1"}),
        (["--scenarios", "0"], {"MLFLOW_TRACKING_URI": "http://127.0.0.1:1"}),
        ([], {}),
    ],
)
def test_a_wrong_request_ends_with_2(arguments, environment, capsys):
    assert command.main(arguments, environment) == 2
    assert "error: " in capsys.readouterr().err


def test_an_unknown_model_ends_with_2_and_a_silent_registry_with_1(tracking, registry, monkeypatch, capsys):
    monkeypatch.setattr(command, "MlflowTracking", lambda uri: tracking)
    monkeypatch.setattr(command, "MlflowRegistry", lambda uri: registry)
    environment = {"MLFLOW_TRACKING_URI": "http://127.0.0.1:1"}
    assert command.main(["--model", f"{MODEL_NAME}/9"], environment) == 2
    registry.away = True
    assert command.main([], environment) == 1
    assert capsys.readouterr().err.count("error: ") == 2


def test_help_names_the_exit_codes(capsys):
    with pytest.raises(SystemExit) as ended:
        command.main(["--help"])
    assert ended.value.code == 0
    assert "Exit codes" in capsys.readouterr().out


def test_a_budget_without_problems_has_no_planning_units():
    assert not [unit for unit in units(TINY, PROBLEMS) if unit.kind == Kind.PLANNING]
