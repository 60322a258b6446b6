"""Versions and runs side by side, by their evaluations."""

import pandas as pd
import pytest

from cspace.bundle import Bundle
from cspace.errors import ConfigError, ModelNotFoundError, RegistryError
from services.evaluator.compare import compare_table, find, write_comparison
from services.evaluator.evaluation import ESTIMATE_COLUMNS
from services.evaluator.report import shown
from tests.bundles import write_tiny_bundle
from tests.fakes.registry import FakeRegistry, FakeTracking

ROWS = (
    ("reconstruction", "validation", "uniform", "sampler", "precision", 0.9, 0.88, 0.92, 60),
    ("reconstruction", "test", "narrow", "sampler", "precision", 0.8, 0.7, 0.9, 5),
    ("planning", "validation", "", "learned", "success", 1.0, 0.9, 1.0, 30),
)


@pytest.fixture
def tracking():
    return FakeTracking()


@pytest.fixture
def registry(tmp_path, tracking):
    return FakeRegistry(tmp_path / "registry", tracking.runs)


def registered(tracking, registry, folder, scale=1.0):
    run = tracking.start("cspace-sampler", "quickstart, seed 0")
    bundle = Bundle.load(write_tiny_bundle(folder, scale=scale))
    return registry.register("m", bundle.folder, run.run_id, bundle.digest, {})


def evaluated(tracking, version, rows=(), **metrics):
    """An evaluation of a version."""
    with tracking.start(
        "cspace-sampler",
        "evaluation",
        parent_run_id=version.run_id,
        tags={"model_version": "1", "model_digest": version.digest},
    ) as run:
        run.metrics(metrics, 0)
        if rows:
            table = pd.DataFrame(rows, columns=ESTIMATE_COLUMNS)
            table["shown"] = [shown(*row[5:8]) for row in rows]
            run.table(table.to_dict("list"), "measures")
        return run.run_id


def test_versions_stand_side_by_side_with_limits_and_gaps(tracking, registry, tmp_path):
    first = registered(tracking, registry, tmp_path / "a")
    second = registered(tracking, registry, tmp_path / "b", 0.5)
    evaluated(tracking, first, ROWS)
    evaluated(tracking, second, ROWS[:1])
    found = [find(text, tracking, registry) for text in ("m/1", "m/2")]
    assert [one.title for one in found] == ["m/1", "m/2"]
    table = compare_table(found)
    assert list(table)[-2:] == ["m/1", "m/2"]
    assert table.to_numpy().tolist() == [
        ["validation", "reconstruction", "uniform", "sampler", "precision"] + 2 * ["0.9000 [0.8800, 0.9200]"],
        ["validation", "planning", "", "learned", "success", "1.0000 [0.9000, 1.0000]", "-"],
    ]
    assert len(compare_table(found, everything=True)) == 3


def test_a_run_is_compared_by_its_own_evaluation_or_its_job_s(tracking, registry, tmp_path):
    version = registered(tracking, registry, tmp_path / "a")
    run_id = evaluated(tracking, version, ROWS)
    runs = tracking
    assert {find(one, runs, registry).run_id for one in (run_id, version.run_id)} == {run_id}


def test_what_was_never_evaluated_is_told_with_what_to_do(tracking, registry, tmp_path):
    registered(tracking, registry, tmp_path / "a")
    with pytest.raises(ConfigError, match=r"m/1 was not evaluated.*services\.evaluator --model m/1"):
        find("m/1", tracking, registry)
    with pytest.raises(ModelNotFoundError):
        find("m/9", tracking, registry)
    with pytest.raises(RegistryError):
        find("0" * 32, tracking, registry)


def test_it_is_kept_as_markdown_and_as_csv(tracking, registry, tmp_path):
    version = registered(tracking, registry, tmp_path / "a")
    run_id = evaluated(tracking, version, ROWS)
    write_comparison([find("m/1", tracking, registry)], tmp_path / "out")
    text = (tmp_path / "out" / "comparison.md").read_text()
    assert text.startswith("| split ")
    assert "0.9000 [0.8800, 0.9200]" in text
    rows = pd.read_csv(tmp_path / "out" / "comparison.csv", keep_default_na=False, dtype=str)
    assert rows[["run_id", "family", "low", "n"]].to_numpy().tolist() == [
        [run_id, "uniform", "0.88", "60"],
        [run_id, "narrow", "0.7", "5"],
        [run_id, "", "0.9", "30"],
    ]
