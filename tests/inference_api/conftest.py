from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from cspace.bundle import write_bundle
from cspace.files import encode_png
from inference_api.app import create_app
from inference_api.settings import ApiSettings
from tests.bundles import picture, tiny_graphs, tiny_spec, write_tiny_bundle
from tests.inference_api.client import ApiClient, running
from tests.inference_api.fake_registry import CountingRegistry


def _careful(folder: Path) -> Path:
    """With a validity head, a threshold of its own, and a sense of novelty."""
    quantiles = ((-1.0, 0.0, 1.0), (0.0, 1.0, 10.0))
    spec = replace(tiny_spec(), confidence_threshold=0.45, novelty_quantiles=quantiles)
    return write_bundle(folder, spec, tiny_graphs(spec, validity=True))


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Requests from the OpenAPI document are made while they are collected, which takes 20 s."""
    made_at_once = collection_path.name == "test_schemathesis.py"
    return True if made_at_once and "not e2e" in config.option.markexpr else None


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
        "careful": _careful(folder / "careful"),
    }


@pytest.fixture(scope="session")
def png() -> bytes:
    return encode_png(picture())


@pytest.fixture
def registry(tmp_path: Path) -> CountingRegistry:
    return CountingRegistry(tmp_path / "registry")


@contextmanager
def api_over(
    folder: Path,
    bundles: dict[str, Path],
    registry: CountingRegistry | None,
    *,
    shipped: bool = True,
    **settings: Any,
) -> Iterator[ApiClient]:
    """An app in this process; its registry is looked at once on start and then only when told."""
    defaults = {
        "model_cache": folder / "cache",
        "model_poll_s": 3600.0,
        "pretrained_model": bundles["shipped"] if shipped else folder / "nothing",
        # Whether or not somebody built the documentation here.
        "api_guide": folder / "no guide",
    }
    with running(create_app(ApiSettings(**(defaults | settings)), registry)) as client:
        yield client


def stock(registry: CountingRegistry, bundles: dict[str, Path]) -> CountingRegistry:
    """Versions 1 to 5: champion, challenger, a path model, one with a validity head, and with a threshold."""
    for bundle, alias in (
        ("plain", "champion"),
        ("other", "challenger"),
        ("path", "path"),
        ("scored", "scored"),
        ("careful", "careful"),
    ):
        registry.add(bundles[bundle], alias)
    return registry


@pytest.fixture
def start_api(tmp_path: Path, bundles: dict[str, Path]) -> Iterator[StartApi]:
    """Starts APIs of the test's own."""
    with ExitStack() as stack:

        def start(registry: CountingRegistry | None = None, **settings: Any) -> ApiClient:
            return stack.enter_context(api_over(tmp_path, bundles, registry, **settings))

        yield start


@pytest.fixture
def own_api(start_api: StartApi, registry: CountingRegistry, bundles: dict[str, Path]) -> ApiClient:
    """An API of the test's own over ``registry``, stocked."""
    return start_api(stock(registry, bundles))


@pytest.fixture(scope="session")
def api(tmp_path_factory: pytest.TempPathFactory, bundles: dict[str, Path]) -> Iterator[ApiClient]:
    """An API over :func:`stock` that tests share: whatever one sends, it must answer the next."""
    folder = tmp_path_factory.mktemp("api")
    with api_over(folder, bundles, stock(CountingRegistry(folder / "registry"), bundles)) as client:
        yield client


@pytest.fixture(scope="session")
def space_bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle of the arm in space, whose graphs PyTorch exports."""
    from tests.space_bundle import write_space_bundle

    return write_space_bundle(tmp_path_factory.mktemp("space") / "bundle")


@pytest.fixture(scope="session")
def space_api(
    tmp_path_factory: pytest.TempPathFactory, bundles: dict[str, Path], space_bundle: Path
) -> Iterator[ApiClient]:
    """An API with the models of :func:`stock`, and that bundle as the champion ``panda-sampler``."""
    folder = tmp_path_factory.mktemp("api")
    registry = stock(CountingRegistry(folder / "registry"), bundles)
    registry.add(space_bundle, "champion", name="panda-sampler")
    with api_over(folder, bundles, registry) as client:
        yield client


@pytest.fixture(scope="session")
def panda_api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ApiClient]:
    """An API with the shipped models of both worlds, without a registry."""
    settings = ApiSettings(model_cache=tmp_path_factory.mktemp("cache"))
    with running(create_app(settings)) as client:
        yield client
