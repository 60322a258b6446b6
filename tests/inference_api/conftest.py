from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from cspace.image import encode_png
from inference_api.app import create_app
from inference_api.settings import ApiSettings
from tests.bundles import picture, write_tiny_bundle
from tests.inference_api.client import ApiClient, running
from tests.inference_api.fake_registry import FakeRegistry

StartApi = Callable[..., ApiClient]


@pytest.fixture(scope="session")
def bundles(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("bundles")
    return {
        "shipped": write_tiny_bundle(folder / "shipped", scale=0.5),
        "plain": write_tiny_bundle(folder / "plain"),
        "other": write_tiny_bundle(folder / "other", scale=2.0, samples_per_latent=4),
        "scored": write_tiny_bundle(folder / "scored", validity=True),
        "path": write_tiny_bundle(folder / "path", kind="path"),
    }


@pytest.fixture(scope="session")
def png() -> bytes:
    return encode_png(picture())


@pytest.fixture
def registry() -> FakeRegistry:
    return FakeRegistry()


@pytest.fixture
def start_api(tmp_path: Path, bundles: dict[str, Path]) -> Iterator[StartApi]:
    """Start an app in this process; its registry is looked at once on start and then only when told."""
    with ExitStack() as stack:

        def start(registry: FakeRegistry | None = None, *, shipped: bool = True) -> ApiClient:
            settings = ApiSettings(
                registry_uri=None,
                cache_folder=tmp_path / "cache",
                poll_s=3600.0,
                pretrained_folder=bundles["shipped"] if shipped else tmp_path / "nothing",
            )
            app = create_app(settings, registry)
            return stack.enter_context(running(app))

        yield start


@pytest.fixture
def api(start_api: StartApi, registry: FakeRegistry, bundles: dict[str, Path]) -> ApiClient:
    """An API over a registry with a champion (1), a challenger (2), a path model (3) and a scored one (4)."""
    registry.add(bundles["plain"], "champion")
    registry.add(bundles["other"], "challenger")
    registry.add(bundles["path"], "path")
    registry.add(bundles["scored"], "scored")
    return start_api(registry)
