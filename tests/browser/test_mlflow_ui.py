"""What people find in the MLflow UI: the job with its trials, their comparison, pictures, data, lineage."""

from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Page
from playwright.sync_api import expect as expect_that

from services.names import MLFLOW_TRAINING, MODEL_NAME
from tests.browser import mlflow_pages
from tests.browser.small_job import CHILDREN, DATA_DIGEST, SmallJob
from tests.contracts.mlflow_warnings import MLFLOW_WARNINGS

pytestmark = [pytest.mark.browser, pytest.mark.slow, pytest.mark.timeout(300), *MLFLOW_WARNINGS]
Shoot = Callable[[str], Path]
SMALLEST_SCREENSHOT = 10_000


def test_the_address_in_the_summary_shows_the_runs_of_jobs(
    page: Page, server: str, experiment_id: str, job: SmallJob
) -> None:
    page.goto(f"{server}/#/experiments/{experiment_id}/runs?{MLFLOW_TRAINING}")
    expect_that(page.get_by_role("gridcell").filter(has_text="cluster-train").first).to_be_visible()


def test_a_job_is_shown_with_its_trials_below_it(
    page: Page, server: str, experiment_id: str, job: SmallJob, shoot: Shoot
) -> None:
    mlflow_pages.open_runs(page, server, experiment_id, "cluster-train")
    for name in CHILDREN:
        expect_that(page.get_by_role("link", name=name, exact=True)).to_be_visible()
    expect_that(page.get_by_role("gridcell").get_by_text("train-0123456789ab").first).to_be_visible()
    assert shoot("runs").stat().st_size > SMALLEST_SCREENSHOT


def test_a_job_shows_its_parameters_its_data_its_trials_and_its_version(
    page: Page, server: str, experiment_id: str, job: SmallJob
) -> None:
    mlflow_pages.open_run(page, server, experiment_id, job.parent)
    for text in ("global.steps", f"train-0123456789ab ({DATA_DIGEST[:8]}", *CHILDREN):
        expect_that(page.get_by_text(text).first).to_be_visible()
    expect_that(page.get_by_role("link", name=MODEL_NAME).first).to_be_visible()


def test_the_curves_of_a_job_are_drawn(
    page: Page, server: str, experiment_id: str, job: SmallJob, shoot: Shoot
) -> None:
    mlflow_pages.open_picture(page, server, experiment_id, job.parent, "figures/wgan-losses.png")
    assert shoot("picture").stat().st_size > SMALLEST_SCREENSHOT


def test_the_local_trials_are_compared_metric_by_metric(
    page: Page, server: str, experiment_id: str, job: SmallJob, shoot: Shoot
) -> None:
    pair = [job.children["local-0"], job.children["local-1"]]
    mlflow_pages.open_comparison(page, server, experiment_id, pair)
    for text in (*pair, "critic_loss", "generator_loss", "-1.05", "-2.05"):
        expect_that(page.get_by_text(text, exact=True).first).to_be_visible()
    assert shoot("comparison").stat().st_size > SMALLEST_SCREENSHOT


def test_a_version_leads_to_the_job_that_made_it(
    page: Page, server: str, experiment_id: str, job: SmallJob, shoot: Shoot
) -> None:
    mlflow_pages.open_version(page, server, MODEL_NAME, job.version)
    for text in ("champion", "challenger", "decision.0001", "data_digest", DATA_DIGEST):
        expect_that(page.get_by_text(text).first).to_be_visible()
    assert shoot("version").stat().st_size > SMALLEST_SCREENSHOT
    page.get_by_role("link", name="cluster-train").first.click()
    expect_that(page.get_by_text(job.parent).first).to_be_visible()
