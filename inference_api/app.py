"""The application: settings in, a FastAPI app out; models are loaded when it starts, not when it is made."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from anyio import to_thread
from fastapi import FastAPI

from cspace.bundle import Bundle, verification
from inference_api.guards.headers import SecurityHeaders
from inference_api.guards.install import add_guards
from inference_api.guards.last_resort import LastResort
from inference_api.memory import few_arenas, settle, trimmed
from inference_api.models.cache import BundleCache, DiskCache
from inference_api.models.pictures import PictureCache
from inference_api.models.served import ShippedModels
from inference_api.models.store import ModelStore, following
from inference_api.models.worker import RegistryWorker
from inference_api.open_inference.pages import add_open_inference
from inference_api.openapi import document
from inference_api.pages.docs_page import add_docs_page
from inference_api.pages.guide import add_guide
from inference_api.pages.model_schemas import ModelInfo
from inference_api.pages.sample import add_routes
from inference_api.pages.sampling import model_info
from inference_api.problems import add_problem_handlers
from inference_api.settings import ApiSettings
from inference_api.telemetry.metrics import Metrics
from inference_api.telemetry.middleware import Observed
from inference_api.telemetry.route_names import RouteNames
from inference_api.telemetry.tracing import TracedObserver, add_tracing, otlp_provider
from inference_api.turns.turns import Turns
from inference_api.turns.waiting_room import WaitingRoom
from inference_api.workbench.routes import add_workbench
from services.registry.models.port import ModelReader
from services.registry.references import PRETRAINED

# Long enough for a registry nearby, short enough for a health check's patience.
FIRST_LOOK_S = 20.0


def create_app(settings: ApiSettings | None = None, registry: ModelReader | None = None) -> FastAPI:
    """The API.

    Args:
        settings: from the environment when None.
        registry: where the models are; MLflow at ``settings.registry_uri`` when None.

    Raises:
        ConfigError: a setting in the environment is wrong, or the file of API keys, or traces or the truth
            of scenes are asked for and their packages are not there.
    """
    settings = settings or ApiSettings.from_environment()
    store = _make_store(settings, registry)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        # Before the first thread has an arena.
        few_arenas()
        app.state.store = store
        app.state.turns = Turns(settings.threads, app.state.metrics.waiting)
        app.state.room = WaitingRoom()
        async with trimmed(), following(store, settings.poll_s, FIRST_LOOK_S):
            settle()
            if app.state.loads_planner:
                store.planner.begin()
            yield
        if app.state.traces is not None:
            # Sends what is still waiting.
            await to_thread.run_sync(app.state.traces.shutdown)

    app = FastAPI(
        title="cspace-sampler",
        version=_version(),
        description="A picture of a scenario goes in, collision-free joint configurations come out.",
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
    )
    add_routes(app)
    add_docs_page(app)
    add_guide(app, settings.guide_folder)
    add_workbench(
        app,
        truth=settings.workbench,
        mlflow_pages=settings.mlflow_pages,
    )
    add_problem_handlers(app)
    add_guards(app, settings.protection)
    app.add_middleware(LastResort)
    add_open_inference(app)
    metrics = Metrics(partial(_default_model, store), settings.metrics_folder)
    provider = otlp_provider() if settings.traces else None
    app.state.metrics, app.state.traces = metrics, provider
    # Servers do; an app that is used in another process loads the search with its first plan.
    app.state.loads_planner = False
    store.observer = metrics if provider is None else TracedObserver(provider, metrics)
    app.add_middleware(Observed, metrics=metrics, names=RouteNames(app.router.routes))
    app.add_middleware(SecurityHeaders)
    if provider is not None:
        add_tracing(app, provider)
    app.openapi = lambda: document(app)  # type: ignore[method-assign]
    return app


def _default_model(store: ModelStore) -> ModelInfo | None:
    served = store.default
    return None if served is None else model_info(served)


def _make_store(settings: ApiSettings, registry: ModelReader | None) -> ModelStore:
    # A registry that is given is known to behave: what comes from it is verified in this process.
    verify = verification.verify if registry is None else _verify_here
    source = RegistryWorker(settings.registry_uri) if registry is None and settings.registry_uri else registry
    disk = DiskCache(settings.cache_folder, settings.stored_bundles)
    return ModelStore(
        source,
        BundleCache(disk, source, verify, settings.loaded_bundles),
        ShippedModels({PRETRAINED: settings.pretrained_folder, **settings.further_folders}),
        settings.model_name,
        settings.poll_s,
        pictures=PictureCache(settings.cached_pictures),
    )


def _verify_here(folder: Path, digest: str) -> None:
    Bundle.load(folder, digest=digest)


def _version() -> str:
    try:
        return version("cspace-sampler")
    except PackageNotFoundError:
        return "0"
