from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path

import pytest

from inference_api.app import create_app
from inference_api.settings import ApiSettings, Protection
from tests.inference_api.client import ApiClient, running
from tests.inference_api.fake_registry import CountingRegistry

StartBench = Callable[..., ApiClient]


def bench_in(
    folder: Path,
    shipped: Path,
    *,
    truth: bool = True,
    protection: Protection | None = None,
    registry: CountingRegistry | None = None,
    mlflow_pages: str | None = None,
) -> AbstractContextManager[ApiClient]:
    """An API with a workbench over a tiny bundle."""
    settings = ApiSettings(
        registry_uri=None,
        cache_folder=folder / "cache",
        poll_s=3600.0,
        pretrained_folder=shipped,
        protection=protection or Protection(),
        workbench=truth,
        mlflow_pages=mlflow_pages,
    )
    return running(create_app(settings, registry))


@pytest.fixture
def start_bench(tmp_path: Path, bundles: dict[str, Path]) -> Iterator[StartBench]:
    """Starts APIs of the test's own."""
    with ExitStack() as stack:
        yield lambda **options: stack.enter_context(bench_in(tmp_path, bundles["shipped"], **options))


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory, bundles: dict[str, Path]) -> Iterator[ApiClient]:
    """An API that the tests of a module share."""
    with bench_in(tmp_path_factory.mktemp("bench"), bundles["shipped"]) as client:
        yield client
