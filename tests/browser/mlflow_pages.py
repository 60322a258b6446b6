"""Pages of the MLflow UI: each function opens one and returns when its content is there."""

import json
from collections.abc import Sequence
from urllib.parse import quote

from playwright.sync_api import Page
from playwright.sync_api import expect as expect_that

from services.names import MLFLOW_TRAINING


def open_runs(page: Page, url: str, experiment_id: str, parent: str) -> None:
    """The table of an experiment's runs, the children of the first parent unfolded."""
    page.goto(f"{url}/#/experiments/{experiment_id}/runs")
    row = page.get_by_role("gridcell").filter(has_text=parent).first
    expect_that(row).to_be_visible()
    row.get_by_role("button").first.click()


def open_view(page: Page, url: str, experiment_id: str, view: str, mode: str = "TABLE") -> None:
    """A saved view of an experiment's runs: ``TABLE``, ``CHART`` or ``ARTIFACT``."""
    place = f"{url}/#/experiments/{experiment_id}/runs?{MLFLOW_TRAINING}&viewStateShareKey={view}"
    page.goto(f"{place}&compareRunsMode={mode}")
    expect_that(page.get_by_text("You're viewing a shared view.").first).to_be_visible()


def open_pictures(page: Page) -> None:
    """The image grid of a view's charts, which is drawn as far as one scrolls."""
    picture = page.get_by_role("img").and_(page.locator("[src^='blob:'], [src*='get-artifact']")).first
    page.mouse.move(900, 700)
    for _ in range(60):
        if picture.is_visible():
            return
        page.mouse.wheel(0, 500)
        page.wait_for_timeout(300)
    expect_that(picture).to_be_visible()


def open_versions(page: Page, url: str, model: str) -> None:
    """The two newest versions of a registered model side by side."""
    page.goto(f"{url}/#/models/{quote(model)}")
    expect_that(page.get_by_role("checkbox").nth(2)).to_be_visible()
    for place in (1, 2):
        page.get_by_role("checkbox").nth(place).check()
    page.get_by_test_id("compareButton").click()
    expect_that(page.get_by_text("Comparing 2 Versions").first).to_be_visible()


def open_run(page: Page, url: str, experiment_id: str, run_id: str) -> None:
    """A run's overview."""
    page.goto(f"{url}/#/experiments/{experiment_id}/runs/{run_id}")
    expect_that(page.get_by_text("About this run").first).to_be_visible()


def open_picture(page: Page, url: str, experiment_id: str, run_id: str, path: str) -> None:
    """A picture among a run's artifacts, drawn."""
    page.goto(f"{url}/#/experiments/{experiment_id}/runs/{run_id}/artifacts/{path}")
    expect_that(page.get_by_alt_text(path)).to_be_visible()
    page.wait_for_function("path => document.querySelector(`img[alt='${path}']`).naturalWidth > 0", arg=path)


def open_comparison(page: Page, url: str, experiment_id: str, run_ids: Sequence[str]) -> None:
    """Two or more runs side by side."""
    runs, experiments = quote(json.dumps(list(run_ids))), quote(json.dumps([experiment_id]))
    # From one comparison to the next the page would keep the first one's runs.
    page.goto("about:blank")
    page.goto(f"{url}/#/compare-runs?runs={runs}&experiments={experiments}")
    expect_that(page.get_by_text(f"Comparing {len(run_ids)} Runs").first).to_be_visible()


def open_version(page: Page, url: str, model: str, version: int) -> None:
    """The page of a registered model's version."""
    page.goto(f"{url}/#/models/{quote(model)}/versions/{version}")
    expect_that(page.get_by_text("Registered At").first).to_be_visible()
