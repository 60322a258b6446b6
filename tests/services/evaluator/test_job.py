import io
import json
from types import SimpleNamespace

import pandas as pd
import pytest

from cspace.bundle import Bundle
from cspace.errors import EvaluationError, ModelNotFoundError
from cspace.worlds.planar.arm import THREE_LINK
from services.evaluator import __main__ as command
from services.evaluator.evaluation import MAX_HEADLINE, MAX_METRICS, Budget
from services.evaluator.job import Request, evaluate_version
from services.names import ALIAS_CHALLENGER, ALIAS_CHAMPION, MODEL_NAME
from services.registry.entities import ModelReference
from services.registry.promotion import decisions, promote
from tests.bundles import write_tiny_bundle
from tests.fakes.registry import FakeRegistry, FakeTracking

SERVER = {"MLFLOW_TRACKING_URI": "http://127.0.0.1:1"}
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


def request(model=f"{MODEL_NAME}@{ALIAS_CHALLENGER}"):
    return Request(ModelReference.parse(model), TINY)


@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    return Bundle.load(write_tiny_bundle(tmp_path_factory.mktemp("tiny") / "bundle"))


def challenged(folder, bundle):
    """Tracking, and a registry with one version, the challenger, made by the run of a training."""
    tracking = FakeTracking()
    registry = FakeRegistry(folder / "registry", tracking.runs)
    run = tracking.start(MODEL_NAME, "cluster-train")
    registry.register(MODEL_NAME, bundle.folder, run.run_id, bundle.digest, {}, alias=ALIAS_CHALLENGER)
    return tracking, registry


@pytest.fixture
def stores(tmp_path, bundle, verified_here):
    return challenged(tmp_path, bundle)


@pytest.fixture(scope="module")
def refused(tmp_path_factory, bundle):
    """An evaluation that refused the challenger: its outcome, run, lines, tracking and registry."""
    tracking, registry = challenged(tmp_path_factory.mktemp("judged"), bundle)
    lines = []
    outcome = evaluate_version(request(), tracking, registry, progress=lines.append)
    run = tracking.runs[outcome.run_id]
    return SimpleNamespace(outcome=outcome, run=run, lines=lines, tracking=tracking, registry=registry)


def evaluated(stores, **changes):
    return evaluate_version(request(**changes), *stores, progress=lambda line: None)


def test_an_evaluation_is_a_child_of_the_training_with_metrics_report_and_pictures(refused):
    outcome, run = refused.outcome, refused.run
    assert (run.name, run.status) == (f"{MODEL_NAME}/1 judged, seed 0, {run.run_id[:6]}", "FINISHED")
    assert run.parent_run_id == refused.registry.version(MODEL_NAME, 1).run_id
    precision = outcome.evaluation.estimate("precision", "uniform", "uniform", "test")
    assert run.history["test/uniform_precision"][0][1] == precision.estimate
    assert len(run.history) <= MAX_METRICS
    tags = {"stage": "evaluation", "model_version": f"{MODEL_NAME}/1", "world": "planar, two-link"}
    assert tags.items() <= run.tags.items()
    assert run.params["samples"] == str(outcome.evaluation.setting.budget.samples)
    report = run.artifacts["report/evaluation.md"].decode()
    assert "\n\nEvaluated on scenes of the planar world with 3 discs" in report
    kept = pd.read_parquet(io.BytesIO(run.artifacts["report/evaluation.parquet"]))
    pd.testing.assert_frame_equal(kept, outcome.evaluation.table, check_dtype=False)
    assert {f"figures/{name}.png" for name in outcome.figures} <= set(run.artifacts)


def test_every_estimate_stands_in_a_table_with_its_limits(refused):
    table = json.loads(refused.run.artifacts["tables/measures.json"])
    rows = [dict(zip(table["columns"], row, strict=True)) for row in table["data"]]
    of = ("task", "split", "family", "sampler", "measure")
    found = {tuple(row[name] for name in of): row for row in rows}
    one = found["reconstruction", "test", "uniform", "uniform", "coverage"]
    known = refused.outcome.evaluation.estimate("coverage", "uniform", "uniform", "test")
    assert [one[name] for name in ("value", "low", "high")] == [known.estimate, known.low, known.high]
    assert one["n"] == TINY.scenarios
    assert len(found) == len(rows) == len({row["estimate"] for row in rows})
    assert one["shown"] == f"{one['value']:.4f} [{one['low']:.4f}, {one['high']:.4f}]"


def test_the_headline_is_shown_on_the_version_and_on_the_run_that_made_it(refused):
    (metrics, note), version = (
        refused.registry.shown[MODEL_NAME, 1],
        refused.registry.version(MODEL_NAME, 1),
    )
    assert {"validation/precision", "test/coverage", "validation/edr"} <= set(metrics)
    assert len(metrics) <= MAX_HEADLINE
    made = refused.tracking.runs[version.run_id].history
    assert {name: points[-1][1] for name, points in made.items()} == metrics
    assert note.startswith(f"## {MODEL_NAME}/1: not promoted")
    assert all(f"- {reason}" in note for reason in refused.outcome.verdict.reasons)
    assert refused.run.artifacts["report/comparison.md"].decode() == note


def test_a_refused_version_is_recorded_and_the_champion_stays(refused):
    assert not refused.outcome.verdict.promoted
    (decision,) = decisions(refused.registry, MODEL_NAME)
    assert not decision.promoted
    assert decision.reasons == refused.outcome.verdict.reasons
    assert set(decision.metrics) == {"precision", "coverage", "edr"}
    with pytest.raises(ModelNotFoundError):
        refused.registry.by_alias(MODEL_NAME, ALIAS_CHAMPION)


def test_a_champion_is_not_compared_with_its_own_promotion(stores):
    promote(stores[1], stores[1].version(MODEL_NAME, 1), "by hand")
    assert evaluated(stores).verdict.bar.against is None


def test_an_evaluation_that_fails_leaves_a_failed_run_and_no_decision(stores):
    def failing(work, setting, packed):
        raise EvaluationError("a unit failed")
        yield

    tracking, registry = stores
    with pytest.raises(EvaluationError):
        evaluate_version(request(), tracking, registry, failing, lambda line: None)
    assert [run.status for run in tracking.runs.values()] == ["RUNNING", "FAILED"]
    assert decisions(registry, MODEL_NAME) == ()


def test_a_path_model_is_not_judged_without_problems(stores, tmp_path):
    tracking, registry = stores
    bundle = Bundle.load(write_tiny_bundle(tmp_path / "path", THREE_LINK, kind="path"))
    run_id = tracking.start(MODEL_NAME, "cluster-train").run_id
    registry.register(MODEL_NAME, bundle.folder, run_id, bundle.digest, {})
    with pytest.raises(EvaluationError, match="path models are evaluated on"):
        evaluated(stores, model=f"{MODEL_NAME}/2")


@pytest.fixture
def commanded(stores, monkeypatch):
    """The command finds these stores where MLflow would be, and asks for little."""
    monkeypatch.setattr(command, "connect", lambda uri: stores)
    monkeypatch.setattr(command, "make_request", lambda options: request(options.model))
    return stores


def test_the_command_prints_the_tables_a_block_and_a_result_line(commanded, capsys, tmp_path):
    data = tmp_path / "data"
    assert command.main([], SERVER | {"CSPACE_DATA_DIR": str(data)}) == 0
    *lines, last = capsys.readouterr().out.splitlines()
    result = json.loads(last.removeprefix("RESULT "))
    assert (result["model"], result["version"], result["promoted"]) == (MODEL_NAME, 1, False)
    assert {"validation/precision", "test/edr"} <= result["metrics"].keys()
    assert any(line.startswith("not promoted") for line in lines)
    assert result["judged_on"] in lines
    kept = data / "jobs" / result["run_id"] / "result.json"
    assert json.loads(kept.read_text()) == result
    block = lines[lines.index("result") :]
    assert block[1] == f"  model     {MODEL_NAME}/1, digest {result['digest'][:12]}"
    assert block[2:4] == ["  promoted  no", f"  run       {result['run_id']}"]
    assert block[-1] == f"  as JSON   {kept}"


@pytest.mark.parametrize(("arguments", "environment"), [(["--model", "nothing"], SERVER), ([], {})])
def test_a_wrong_request_ends_with_2(arguments, environment, capsys):
    assert command.main(arguments, environment) == 2
    assert "error: " in capsys.readouterr().err


def test_an_unknown_model_ends_with_2_and_a_silent_registry_with_1(commanded, capsys):
    assert command.main(["--model", f"{MODEL_NAME}/9"], SERVER) == 2
    commanded[1].away = True
    assert command.main([], SERVER) == 1
    assert capsys.readouterr().err.count("error: ") == 2
