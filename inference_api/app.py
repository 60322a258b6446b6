"""The application: settings in, a FastAPI app out; models are loaded when it starts, not when it is made."""

import asyncio
import gc
import os
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from threading import Event, Thread
from typing import TYPE_CHECKING

from anyio import to_thread
from fastapi import FastAPI
from fastapi.middleware.cors import CORSMiddleware
from fastapi.middleware.trustedhost import TrustedHostMiddleware

from cspace.bundle import Bundle
from cspace.bundle.load import verify
from inference_api.auth import RequireKey, read_keys
from inference_api.kernels import SearchKernels
from inference_api.limits import (
    LOOPBACK_NAMES,
    ComputePlaces,
    LimitRequests,
    RefuseForeignOrigins,
)
from inference_api.pictures import PictureCache
from inference_api.problems import PROBLEM_RESPONSES, add_problem_handlers
from inference_api.routes import belief, doctor, models, outcomes, plan, sample, validity
from inference_api.routes.documentation import add_docs_page, add_guide, document
from inference_api.served_models import ModelStore
from inference_api.settings import ApiSettings
from inference_api.telemetry import OUTCOMES, RELOADS, Telemetry, add_tracing
from inference_api.workbench.routes import add_workbench
from services.commands import settings_of
from services.outcomes import Receipts, Spool

if TYPE_CHECKING:
    from services.registry.models import ModelRegistry

# For the first look at the registry: long enough for one nearby, short enough for a health check's patience.
FIRST_LOOK_S = 20.0
# Between two looks for kept pictures whose days are over.
EXPIRY_S = 3600.0
# Threads that compute come back to the interpreter after every graph, and would wait for 5 ms each time.
SWITCH_S = 0.00005


def create_app(settings: ApiSettings | None = None, registry: "ModelRegistry | None" = None) -> FastAPI:
    """The API with settings of the environment, and MLflow at ``settings.registry_uri``, unless given."""
    settings = settings or settings_of(ApiSettings)
    app = FastAPI(
        title="cspace-sampler",
        version=_version(),
        description="A picture of a scenario goes in, collision-free joint configurations come out.",
        lifespan=_lifespan,
        responses=PROBLEM_RESPONSES,
        docs_url=None,
        redoc_url=None,
    )
    store = _model_store(settings, registry)
    store.on_reload = lambda outcome: RELOADS.labels(outcome).inc()
    app.state.settings, app.state.models = settings, store
    app.state.places = ComputePlaces(settings.api_threads)
    app.state.kernels, app.state.pictures = SearchKernels(), PictureCache()
    app.state.spool = app.state.receipts = None
    if settings.outcomes is not None:
        app.state.receipts = Receipts.of(settings.outcomes, settings.receipt_key)
        app.state.spool = Spool(
            settings.outcomes,
            int(2**20 * settings.outcomes_mib),
            lambda result, count: OUTCOMES.labels(result).inc(count),
        )
    # Servers load the search when they start; an app in another process with its first plan.
    app.state.loads_planner = False
    for routes in (sample, validity, plan, belief, doctor, outcomes, models):
        app.include_router(routes.router)
    add_docs_page(app)
    add_guide(app, settings.api_guide)
    add_workbench(app, truth=settings.api_workbench)
    add_problem_handlers(app)
    _add_middleware(app, settings)
    if os.environ.get("OTEL_EXPORTER_OTLP_ENDPOINT"):
        add_tracing(app)
    app.openapi = lambda: document(app, settings.model_name)  # type: ignore[method-assign]
    return app


def _add_middleware(app: FastAPI, settings: ApiSettings) -> None:
    """What is added last is asked first."""
    app.add_middleware(LimitRequests, max_in_flight=settings.api_max_in_flight)
    if settings.api_keys_file is not None:
        app.add_middleware(RequireKey, keys=read_keys(settings.api_keys_file))
    if settings.api_origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=settings.api_origins,
            allow_methods=["GET", "POST"],
            allow_headers=["*"],
            expose_headers=["*"],
        )
    app.add_middleware(RefuseForeignOrigins, origins=settings.api_origins)
    app.add_middleware(
        TrustedHostMiddleware, allowed_hosts=[*LOOPBACK_NAMES, *settings.api_hosts], www_redirect=False
    )
    app.add_middleware(Telemetry)


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    sys.setswitchinterval(SWITCH_S)
    store, spool, looked = app.state.models, app.state.spool, Event()
    # Before the first look, which chooses what stands in by the champion's robot.
    await to_thread.run_sync(store.load_shipped)
    # A daemon, for a look may wait and nobody waits for it.
    Thread(target=store.follow, args=(looked,), name="poll", daemon=True).start()
    await to_thread.run_sync(looked.wait, FIRST_LOOK_S, abandon_on_cancel=True)
    if app.state.loads_planner:
        app.state.kernels.begin()
    # What the start has made stays anyway: later collections, which stop all threads, leave it out.
    gc.collect()
    gc.freeze()
    uri = app.state.settings.registry_uri or ""
    expiring = None if spool is None else asyncio.create_task(_expire(spool, uri))
    yield
    store.ended.set()
    if expiring is not None:
        expiring.cancel()


async def _expire(spool: Spool, registry_uri: str) -> None:
    while True:
        await asyncio.sleep(EXPIRY_S)
        await to_thread.run_sync(spool.delete_expired, registry_uri)


def _version() -> str:
    try:
        return version("cspace-sampler")
    except PackageNotFoundError:
        # Images hold the sources alone.
        return "0"


def _model_store(settings: ApiSettings, registry: "ModelRegistry | None") -> ModelStore:
    if registry is not None:
        # One that is given is known to behave: what comes from it is verified in this process.
        return ModelStore(
            settings, lambda: registry, lambda folder, digest: Bundle.load(folder, digest=digest)
        )
    uri = settings.registry_uri
    return ModelStore(settings, cache(lambda: _mlflow(uri)) if uri else None, verify)


def _mlflow(uri: str) -> "ModelRegistry":
    from services.registry.errors import set_timeouts  # noqa: PLC0415 - MLflow takes seconds

    set_timeouts(os.environ)
    from services.registry.models import ModelRegistry  # noqa: PLC0415 - as above

    return ModelRegistry(uri)
