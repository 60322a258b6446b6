from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from cspace.bundle import write_bundle
from cspace.png import encode_png
from inference_api.app import create_app
from inference_api.settings import PRETRAINED_FOLDER, ApiSettings, Protection
from tests.bundles import picture, tiny_graphs, tiny_spec, write_tiny_bundle
from tests.inference_api.client import ApiClient, running
from tests.inference_api.fake_registry import CountingRegistry


def _careful(folder: Path) -> Path:
    """With a validity head, a threshold of its own, and a sense of novelty."""
    quantiles = ((-1.0, 0.0, 1.0), (0.0, 1.0, 10.0))
    spec = replace(tiny_spec(), confidence_threshold=0.45, novelty_quantiles=quantiles)
    return write_bundle(folder, spec, tiny_graphs(spec, validity=True))


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
def shipped_api(cache: Path, name: str) -> Iterator[ApiClient]:
    """An app with the shipped models of both worlds, that of the Panda under a name, without a registry."""
    panda = Path(PRETRAINED_FOLDER).with_name("pretrained_panda")
    settings = ApiSettings(registry_uri=None, cache_folder=cache, further_folders={name: panda})
    with running(create_app(settings)) as client:
        yield client


@contextmanager
def api_over(
    folder: Path,
    bundles: dict[str, Path],
    registry: CountingRegistry | None,
    *,
    shipped: bool = True,
    protection: Protection | None = None,
) -> Iterator[ApiClient]:
    """An app in this process; its registry is looked at once on start and then only when told."""
    settings = ApiSettings(
        registry_uri=None,
        cache_folder=folder / "cache",
        poll_s=3600.0,
        pretrained_folder=bundles["shipped"] if shipped else folder / "nothing",
        protection=protection or Protection(),
    )
    with running(create_app(settings, registry)) as client:
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

        def start(
            registry: CountingRegistry | None = None,
            *,
            shipped: bool = True,
            protection: Protection | None = None,
        ) -> ApiClient:
            api = api_over(tmp_path, bundles, registry, shipped=shipped, protection=protection)
            return stack.enter_context(api)

        yield start


@pytest.fixture
def own_api(start_api: StartApi, registry: CountingRegistry, bundles: dict[str, Path]) -> ApiClient:
    """An API of the test's own over ``registry``, stocked."""
    return start_api(stock(registry, bundles))


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory, bundles: dict[str, Path]) -> Iterator[ApiClient]:
    """An API that the tests of a module share: whatever one sends, it must answer the next."""
    folder = tmp_path_factory.mktemp("api")
    with api_over(folder, bundles, stock(CountingRegistry(folder / "registry"), bundles)) as client:
        yield client
