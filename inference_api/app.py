"""The application: settings in, a FastAPI app out; models are loaded when it starts, not when it is made."""

from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager, nullcontext
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from anyio import to_thread
from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from cspace.bundle import Bundle, verification
from inference_api.limits import HEALTH, add_limits
from inference_api.models.cache import BundleCache, DiskCache
from inference_api.models.pictures import PictureCache
from inference_api.models.served import ShippedModels
from inference_api.models.store import ModelStore, following
from inference_api.models.worker import RegistryWorker
from inference_api.problem_types import add_problem_handlers
from inference_api.process import few_arenas, repeated, settle, trimmed
from inference_api.requests import Service
from inference_api.routes import belief, doctor, models, open_inference, outcomes, plan, sample, validity
from inference_api.routes.documentation import add_docs_page, add_guide
from inference_api.scheduler import Lookups, Scheduler
from inference_api.schemas import Problem
from inference_api.settings import ApiSettings
from inference_api.telemetry import Metrics, Telemetry
from inference_api.tensors import InferenceRequest
from inference_api.tracing import TracedMetrics, add_tracing, otlp_provider
from inference_api.workbench.routes import add_workbench
from services.outcomes import Receipts, Spool
from services.registry.entities import PRETRAINED, ModelReader

if TYPE_CHECKING:
    from opentelemetry.sdk.trace import TracerProvider

# Long enough for a registry nearby, short enough for a health check's patience.
FIRST_LOOK_S = 20.0
# Between two looks for kept pictures whose time is over.
EXPIRY_S = 3600.0


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
    provider = otlp_provider() if settings.traces else None
    metrics = _make_metrics(settings, store, provider)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        # Before the first thread has an arena.
        few_arenas()
        app.state.store, app.state.service = store, _make_service(settings, store, metrics)
        spool = app.state.service.spool
        flushed: AbstractAsyncContextManager[None] = nullcontext()
        if spool is not None:
            flushed = repeated(partial(spool.delete_expired, settings.registry_uri or ""), EXPIRY_S)
        async with trimmed(), flushed, following(store, settings.poll_s, FIRST_LOOK_S):
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
    for routes in (sample, validity, plan, belief, doctor, outcomes, models, open_inference):
        app.include_router(routes.router)
    add_docs_page(app)
    add_guide(app, settings.guide_folder)
    add_workbench(app, truth=settings.workbench, mlflow_pages=settings.mlflow_pages)
    add_problem_handlers(app)
    add_limits(app, settings.protection)
    app.add_middleware(Telemetry, metrics=metrics, routes=app.router.routes)
    app.state.metrics, app.state.traces = metrics, provider
    # Servers do; an app that is used in another process loads the search with its first plan.
    app.state.loads_planner = False
    if provider is not None:
        add_tracing(app, provider)
    app.openapi = lambda: document(app, settings.model_name)  # type: ignore[method-assign]
    return app


def document(app: FastAPI, default_model: str) -> dict[str, Any]:
    """The OpenAPI document, made once: FastAPI's, with what it cannot see of the app.

    Args:
        app: whose routes are described.
        default_model: that answers requests which name none.
    """
    if app.openapi_schema is None:
        made = get_openapi(
            title=app.title, version=app.version, description=app.description, routes=app.routes
        )
        components = made.setdefault("components", {})
        components["securitySchemes"] = {"key": {"type": "http", "scheme": "bearer"}}
        # Either none or a key, for whoever runs the server decides.
        made["security"] = [{}, {"key": []}]
        for path in HEALTH:
            made["paths"][path]["get"]["security"] = []
        for path in ("/sample", "/validity", "/plan", "/belief", "/doctor"):
            for body in made["paths"][path]["post"]["requestBody"]["content"].values():
                body["schema"]["properties"]["model"]["default"] = default_model
        schemas = components.setdefault("schemas", {})
        for unseen in (Problem, InferenceRequest, outcomes.OutcomesRequest):
            schema = unseen.model_json_schema(ref_template="#/components/schemas/{model}")
            schemas.update(schema.pop("$defs", {}))
            schemas[unseen.__name__] = schema
        app.openapi_schema = made
    return app.openapi_schema


def _make_store(settings: ApiSettings, registry: ModelReader | None) -> ModelStore:
    # A registry that is given is known to behave: what comes from it is verified in this process.
    verify = verification.verify if registry is None else _verify_here
    source = RegistryWorker(settings.registry_uri) if registry is None and settings.registry_uri else registry
    disk = DiskCache(settings.cache_folder, settings.stored_bundles)
    return ModelStore(
        source,
        BundleCache(disk, source, verify, settings.loaded_bundles, trusted_key=settings.trusted_key),
        ShippedModels({PRETRAINED: settings.pretrained_folder, **settings.further_folders}),
        settings.model_name,
        settings.poll_s,
        pictures=PictureCache(settings.cached_pictures),
    )


def _make_metrics(settings: ApiSettings, store: ModelStore, provider: "TracerProvider | None") -> Metrics:
    if provider is None:
        metrics = Metrics(lambda: store.default, settings.metrics_folder)
    else:
        metrics = TracedMetrics(provider, lambda: store.default, settings.metrics_folder)
    store.on_champion = metrics.followed
    return metrics


def _make_service(settings: ApiSettings, store: ModelStore, metrics: Metrics) -> Service:
    scheduler, lookups = Scheduler(settings.threads, metrics.waiting), Lookups()
    folder, most_bytes = settings.outcomes_folder, settings.outcomes_bytes
    spool = None if folder is None else Spool(folder, most_bytes, metrics.outcomes)
    receipts = None if folder is None else Receipts.of(folder, settings.receipt_key)
    keep_s = 86_400.0 * settings.kept_pictures_days
    return Service(store, scheduler, lookups, metrics, spool, receipts, keep_s)


def _verify_here(folder: Path, digest: str) -> None:
    Bundle.load(folder, digest=digest)


def _version() -> str:
    try:
        return version("cspace-sampler")
    except PackageNotFoundError:
        return "0"
