"""Pictures of a live MLflow UI for the documents.

python -m tests.browser.screenshot --mlflow http://127.0.0.1:5000 --page compare --out docs/images/mlflow.png
"""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

from mlflow import MlflowClient
from mlflow.entities import Run
from playwright.sync_api import Page

from services.names import EXPERIMENT, MODEL_NAME, TAG_STAGE
from tests.browser import mlflow_pages
from tests.browser.chromium import browser_page

STAGE = "cluster-train"
# Plots animate; the UI has no sign of the end that could be waited for.
SETTLE_MS = 2500


def main() -> int:
    """Parse, open the page of the latest job, take the picture."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.browser.screenshot",
        description="Take a picture of the latest job in a live MLflow UI.",
    )
    parser.add_argument("--mlflow", default="http://127.0.0.1:5000", help="default %(default)s")
    parser.add_argument("--page", choices=sorted(PAGES), default="runs", help="default %(default)s")
    parser.add_argument("--out", type=Path, required=True, help="the PNG file")
    options = parser.parse_args()
    job = _latest_job(options.mlflow)
    with browser_page() as page:
        PAGES[options.page](page, options.mlflow, job)
        page.wait_for_timeout(SETTLE_MS)
        page.screenshot(path=options.out)
    print(f"{options.page} of run {job.info.run_id}: {options.out}")  # noqa: T201 - it is a command
    return 0


def _latest_job(url: str) -> Run:
    client = MlflowClient(url)
    experiment = client.get_experiment_by_name(EXPERIMENT)
    found = client.search_runs(
        [experiment.experiment_id],
        f"tags.{TAG_STAGE} = '{STAGE}' and attributes.status = 'FINISHED'",
        max_results=1,
    )
    if not found:
        raise SystemExit(f"there is no finished {STAGE} run at {url}: train first")
    return found[0]


def _runs(page: Page, url: str, job: Run) -> None:
    mlflow_pages.open_runs(page, url, job.info.experiment_id, str(job.info.run_name))


def _run(page: Page, url: str, job: Run) -> None:
    mlflow_pages.open_run(page, url, job.info.experiment_id, job.info.run_id)


def _picture(page: Page, url: str, job: Run) -> None:
    mlflow_pages.open_picture(
        page, url, job.info.experiment_id, job.info.run_id, "figures/samples-unseen.png"
    )


def _compare(page: Page, url: str, job: Run) -> None:
    children = MlflowClient(url).search_runs(
        [job.info.experiment_id], f"tags.`mlflow.parentRunId` = '{job.info.run_id}'"
    )
    local = sorted((run.info.run_name, run.info.run_id) for run in children)
    pair = [run_id for name, run_id in local if name.startswith("local-")]
    mlflow_pages.open_comparison(page, url, job.info.experiment_id, pair)


def _version(page: Page, url: str, job: Run) -> None:
    versions = MlflowClient(url).search_model_versions(f"name = '{MODEL_NAME}'")
    number = next(int(one.version) for one in versions if one.run_id == job.info.run_id)
    mlflow_pages.open_version(page, url, MODEL_NAME, number)


def _jobs(page: Page, url: str, job: Run) -> None:
    mlflow_pages.open_view(page, url, job.info.experiment_id, "jobs")


def _versions(page: Page, url: str, job: Run) -> None:
    mlflow_pages.open_versions(page, url, MODEL_NAME)


PAGES: dict[str, Callable[[Page, str, Run], None]] = {
    "runs": _runs,
    "run": _run,
    "picture": _picture,
    "compare": _compare,
    "version": _version,
    "jobs": _jobs,
    "versions": _versions,
}


if __name__ == "__main__":
    sys.exit(main())
