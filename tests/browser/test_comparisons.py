"""What people compare in the MLflow UI: real jobs of two presets and two seeds, their trials and versions."""

from collections.abc import Callable
from pathlib import Path

import pytest
from mlflow import MlflowClient
from playwright.sync_api import Page
from playwright.sync_api import expect as expect_that

from services.names import EXPERIMENT, MODEL_NAME
from tests.browser import mlflow_pages
from tests.browser.real_jobs import RealJob, run_jobs
from tests.contracts.mlflow_server import mlflow_server
from tests.contracts.mlflow_warnings import MLFLOW_WARNINGS

pytestmark = [pytest.mark.browser, pytest.mark.slow, pytest.mark.timeout(1500), *MLFLOW_WARNINGS]
Shoot = Callable[[str], Path]


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with mlflow_server(tmp_path_factory.mktemp("mlflow")) as url:
        yield url


@pytest.fixture(scope="module")
def jobs(server, tmp_path_factory) -> list[RealJob]:
    return run_jobs(server, tmp_path_factory.mktemp("data"))


@pytest.fixture(scope="module")
def client(server, jobs) -> MlflowClient:
    return MlflowClient(server)


@pytest.fixture(scope="module")
def experiment_id(client) -> str:
    return str(client.get_experiment_by_name(EXPERIMENT).experiment_id)


def seen(page: Page, *texts: str) -> None:
    for text in texts:
        expect_that(page.get_by_text(text).first).to_be_visible()


def title(job: RealJob) -> str:
    return f"{job.preset}, seed {job.seed}, {job.run_id[:6]}"


def test_the_table_of_jobs_tells_them_apart_with_settings_and_quality(
    page: Page, server: str, experiment_id: str, client: MlflowClient, jobs: list[RealJob], shoot: Shoot
) -> None:
    mlflow_pages.open_view(page, server, experiment_id, "jobs")
    seen(page, *map(title, jobs), "clusters.form", "mixture", "guided", "validation/edr")
    for job in jobs:
        value = client.get_run(job.run_id).data.metrics["validation/coverage"]
        seen(page, str(value)[:6])
    assert shoot("jobs").stat().st_size > 10_000


def test_two_jobs_are_compared_by_what_differs(
    page: Page, server: str, experiment_id: str, jobs: list[RealJob]
) -> None:
    pair = [jobs[0], jobs[-1]]
    mlflow_pages.open_comparison(page, server, experiment_id, [job.run_id for job in pair])
    seen(page, *map(title, pair), "clusters.form", "guided", "mixture", "validation/precision")


def test_local_trials_of_two_jobs_are_compared_by_parameters_and_metrics(
    page: Page, server: str, experiment_id: str, client: MlflowClient, jobs: list[RealJob]
) -> None:
    pair = [jobs[0].run_id, jobs[-1].run_id]
    of = [f"tags.stage = 'local' and tags.`mlflow.parentRunId` = '{run_id}'" for run_id in pair]
    trials = [run for query in of for run in client.search_runs([experiment_id], query)]
    assert len(trials) == 4
    assert {"cluster", "share_of_data", "steps", "seed", "device"} <= set(trials[0].data.params)
    mlflow_pages.open_comparison(page, server, experiment_id, [run.info.run_id for run in trials])
    # The UI shortens fractions.
    params = trials[0].data.params
    seen(
        page,
        "share_of_data",
        "configurations",
        params["configurations"],
        "critic_loss",
        "local-1, quickstart",
    )


def test_evaluations_stand_side_by_side_estimate_by_estimate(
    page: Page, server: str, experiment_id: str, jobs: list[RealJob]
) -> None:
    mlflow_pages.open_view(page, server, experiment_id, "evaluations", "ARTIFACT")
    seen(page, "tables/measures.json", "validation uniform sampler reconstruction coverage")
    seen(page, f"{jobs[-1].version} judged, seed 0", f"{jobs[-2].version} judged, seed 0")


def test_galleries_stand_beside_each_other(
    page: Page, server: str, experiment_id: str, jobs: list[RealJob], shoot: Shoot
) -> None:
    mlflow_pages.open_view(page, server, experiment_id, "evaluations", "CHART")
    mlflow_pages.open_pictures(page)
    assert shoot("grid").stat().st_size > 10_000


def test_versions_are_compared_with_the_headline(page: Page, server: str, jobs: list[RealJob]) -> None:
    mlflow_pages.open_versions(page, server, MODEL_NAME)
    seen(page, title(jobs[-1]), title(jobs[-2]), "validation/precision", "test/edr")


def test_a_version_s_page_tells_what_changed(page: Page, server: str, jobs: list[RealJob]) -> None:
    model, _, number = jobs[-1].version.partition("/")
    mlflow_pages.open_version(page, server, model, int(number))
    seen(page, f"{jobs[-1].version}: not promoted", "uniform beyond the interval")


def test_an_evaluation_has_few_metrics_and_says_what_it_is(client: MlflowClient, jobs: list[RealJob]) -> None:
    for job in jobs:
        run = client.get_run(job.evaluation)
        assert len(run.data.metrics) <= 60
        assert run.data.tags["model_version"] == job.version
        assert len(client.get_run(job.run_id).data.metrics) <= 16
