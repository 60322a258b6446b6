"""The pages of the API; each hands its work to a thread and comes back with the answer."""

import time
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any

from fastapi import APIRouter, FastAPI, Request
from fastapi.responses import PlainTextResponse, Response
from fastapi.routing import APIRoute

from inference_api.bodies.request_body import read_fields
from inference_api.guards.rate import client_of
from inference_api.pages.dependencies import Room, Store, Turn, room_of, store_of, turns_of
from inference_api.pages.described import (
    GUARD_PROBLEMS,
    plan_extra,
    plan_responses,
    problem_responses,
    sample_extra,
    sample_responses,
    validity_extra,
    validity_responses,
)
from inference_api.pages.exchange import respond
from inference_api.pages.health import default_model
from inference_api.pages.listing import listed
from inference_api.pages.model_schemas import ModelList
from inference_api.pages.planning.question import read_plan
from inference_api.pages.sampling import model_info, prefers_npy, read_question
from inference_api.pages.schemas import Live, Ready
from inference_api.pages.validity import read_validity
from inference_api.problems import INVALID_VALUE, NO_MODEL, STARTING, UNAUTHORIZED
from inference_api.telemetry.metrics import CONTENT_TYPE, Metrics

router = APIRouter()


class DirectRoute(APIRoute):
    """A route whose function takes the request and returns the response, with nothing put in between.

    What FastAPI does for parameters that there are none of would cost a fiftieth of an answer.
    """

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """The function itself."""
        handler: Callable[[Request], Coroutine[Any, Any, Response]] = self.endpoint
        return handler


def add_routes(app: FastAPI) -> None:
    """Serve the pages; that which is asked most is looked up first."""
    app.router.add_api_route(
        "/sample",
        sample,
        methods=["POST"],
        summary="Draw collision-free configurations for a picture",
        openapi_extra=sample_extra(),
        responses=sample_responses(),
        route_class_override=DirectRoute,
    )
    app.router.add_api_route(
        "/validity",
        validity,
        methods=["POST"],
        summary="Tell which configurations are free in a picture's scenario",
        openapi_extra=validity_extra(),
        responses=validity_responses(),
        route_class_override=DirectRoute,
    )
    app.router.add_api_route(
        "/plan",
        plan,
        methods=["POST"],
        summary="Plan a way through a picture's scenario, or tell why there is none",
        openapi_extra=plan_extra(),
        responses=plan_responses(),
        route_class_override=DirectRoute,
    )
    app.include_router(router)


async def sample(request: Request) -> Response:
    """The same seed, picture, parameters and model digest give the same samples on one machine.

    With `Accept: application/x-npy` the answer is the samples alone as a float32 `.npy`, the rest in headers.
    """
    began = time.perf_counter()
    npy = prefers_npy(request.headers.get("accept"))
    fields = await read_fields(request)
    store = store_of(request)
    ask = partial(read_question, store, fields, npy=npy, began=began)
    return await respond(request, store, turns_of(request), room_of(request), ask)


async def validity(request: Request) -> Response:
    """The validity head's confidence for each of the configurations, whatever they were drawn by.

    With `Accept: application/x-npy` the answer is a float32 `.npy` of two columns, the rest in headers.
    """
    began = time.perf_counter()
    npy = prefers_npy(request.headers.get("accept"))
    fields = await read_fields(request)
    store = store_of(request)
    ask = partial(read_validity, store, fields, npy=npy, began=began)
    return await respond(request, store, turns_of(request), room_of(request), ask)


async def plan(request: Request) -> Response:
    """Of several ways through what the picture shows the one that the model doubts least.

    What no picture shows is free for the search; how likely it is free is the model's to say.
    """
    began = time.perf_counter()
    fields = await read_fields(request)
    store = store_of(request)
    ask = partial(read_plan, store, fields, began=began)
    return await respond(request, store, turns_of(request), room_of(request), ask)


@router.get(
    "/models",
    summary="Models that requests can name",
    responses=problem_responses(*GUARD_PROBLEMS, INVALID_VALUE),
)
async def models(request: Request, store: Store, room: Room, name: str | None = None) -> ModelList:
    """Versions of the model of this name, absent of the default one, newest first, and the shipped model."""
    return await room.run(partial(listed, store, name), client_of(request.scope))


@router.get(
    "/metrics",
    summary="What Prometheus scrapes",
    response_class=PlainTextResponse,
    responses=problem_responses(UNAUTHORIZED),
)
async def metrics(request: Request) -> Response:
    """Requests, failures, latencies, acceptance, reloads and the model in service, as text."""
    found: Metrics = request.app.state.metrics
    return Response(found.render(), media_type=CONTENT_TYPE)


@router.get("/health/live", summary="Whether the process answers")
async def live() -> Live:
    """Always ok; says nothing about models."""
    return Live()


@router.get(
    "/health/ready",
    summary="Whether samples can be asked for",
    responses=problem_responses(NO_MODEL, STARTING),
)
async def ready(store: Store, turns: Turn) -> Ready:
    """The model that answers requests that name none; 503 at the start, without one, or while none ends."""
    served = default_model(store, turns)
    return Ready(registry=store.registry_state, successor=store.successor, model=model_info(served))
