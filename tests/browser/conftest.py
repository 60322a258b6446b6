from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from mlflow import MlflowClient
from playwright.sync_api import Page

from tests.browser.chromium import browser_page
from tests.browser.small_job import SmallJob, write_small_job
from tests.contracts.mlflow_server import mlflow_server


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a real MLflow server."""
    with mlflow_server(tmp_path_factory.mktemp("mlflow")) as url:
        yield url


@pytest.fixture(scope="session")
def job(server: str, tmp_path_factory: pytest.TempPathFactory) -> SmallJob:
    return write_small_job(server, tmp_path_factory.mktemp("job"))


@pytest.fixture(scope="session")
def experiment_id(server: str, job: SmallJob) -> str:
    return str(MlflowClient(server).get_run(job.parent).info.experiment_id)


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    with browser_page() as opened:
        yield opened


@pytest.fixture
def shoot(page: Page, tmp_path: Path) -> Callable[[str], Path]:
    """Takes a picture of the page as it is."""

    def take(name: str) -> Path:
        path = tmp_path / f"{name}.png"
        page.screenshot(path=path)
        return path

    return take
