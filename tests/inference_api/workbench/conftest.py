from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from inference_api.app import create_app
from inference_api.settings import ApiSettings, Protection
from tests.inference_api.client import ApiClient, running
from tests.inference_api.fake_registry import CountingRegistry

StartBench = Callable[..., ApiClient]


@pytest.fixture
def start_bench(tmp_path: Path, bundles: dict[str, Path]) -> Iterator[StartBench]:
    """Starts an API with a workbench over tiny bundles."""
    with ExitStack() as stack:

        def start(
            *,
            truth: bool = True,
            protection: Protection | None = None,
            registry: CountingRegistry | None = None,
            mlflow_pages: str | None = None,
        ) -> ApiClient:
            settings = ApiSettings(
                registry_uri=None,
                cache_folder=tmp_path / "cache",
                poll_s=3600.0,
                pretrained_folder=bundles["shipped"],
                protection=protection or Protection(),
                workbench=truth,
                mlflow_pages=mlflow_pages,
            )
            return stack.enter_context(running(create_app(settings, registry)))

        yield start


@pytest.fixture
def bench(start_bench: StartBench) -> ApiClient:
    return start_bench()
