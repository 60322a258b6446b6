"""``POST /sample``: collision-free configurations for a picture."""

import time
from typing import Annotated

from fastapi import APIRouter, Depends
from fastapi.responses import Response

from cspace.bundle.spec import fitted
from cspace.query import SampleQuery, random_seed
from cspace_client.wire import ProposalCounts, SampleAnswer, TimingMs
from inference_api.kernels import Kernels, needs_kernels
from inference_api.limits import ComputePlace
from inference_api.pictures import PreparedPictures
from inference_api.request_body import body_of, both_bodies
from inference_api.scene import (
    SampleRequest,
    WantsNpy,
    about,
    has_known,
    json_response,
    npy_response,
    npy_responses,
    robot_of,
    served_for,
    view_of,
    warnings_of,
)
from inference_api.served_models import ServedModel
from inference_api.telemetry import ACCEPTANCE, STAGES, request_fields

_HEADERS = {
    "X-Seed": "The seed that was used, in decimal.",
    "X-Shortfall": "n minus what was returned.",
    "X-Acceptance": "Share of the generated samples that reached the requested confidence.",
    "Server-Timing": "decode, encode, generate and total, in ms.",
}

router = APIRouter()


@router.post(
    "/sample",
    summary="Draw collision-free configurations for a picture",
    openapi_extra=both_bodies(SampleRequest),
    responses=npy_responses(SampleAnswer, "float32 array (samples, joints)", _HEADERS),
)
def sample(
    request: Annotated[SampleRequest, Depends(body_of(SampleRequest))],
    served: Annotated[ServedModel, Depends(served_for(SampleRequest))],
    place: ComputePlace,
    pictures: PreparedPictures,
    kernels: Kernels,
    npy: WantsNpy,
) -> Response:
    """The same seed, picture, parameters and model digest give the same samples on one machine.

    With `Accept: application/x-npy` the answer is the samples alone as a float32 `.npy`, the rest in headers.
    """
    began = time.perf_counter()
    bundle, world = served.bundle, served.bundle.spec.world
    query = fitted(_query_of(request), bundle.spec, has_validity=bundle.has_validity)
    if has_known(request):
        kernels.require()
    prepared = pictures.prepare(bundle, view_of(request), place.check_cancelled, request.check_pose)
    # A ``.npy`` holds samples alone: nobody would see the scores of those that are not filtered.
    with needs_kernels():
        found = bundle.answer(
            prepared.picture, query, report_confidence=not npy, check_cancelled=place.check_cancelled
        )
    # Without a confidence to reach all are taken.
    warnings = warnings_of(prepared.findings_with(world, colliding=1.0 - found.acceptance))
    timing = TimingMs(
        decode=prepared.decode_ms,
        encode=prepared.encode_ms,
        generate=found.generate_ms,
        total=1e3 * (time.perf_counter() - began),
    )
    for stage, value_ms in timing.model_dump().items():
        STAGES.labels(stage).observe(1e-3 * value_ms)
    ACCEPTANCE.observe(found.acceptance)
    # JSON's numbers end at 53 bits, a seed does not.
    request_fields.get().update(model=str(served), n=query.n, seed=str(query.seed), shortfall=found.shortfall)
    novelty = prepared.picture.novelty
    if npy:
        headers = {
            "X-Seed": str(query.seed),
            "X-Shortfall": str(found.shortfall),
            "X-Acceptance": f"{found.acceptance:.6g}",
        }
        return npy_response(found.samples, served, novelty, warnings, timing, headers)
    return json_response(
        SampleAnswer.model_construct(
            samples=found.samples,
            confidence=found.confidence,
            unseen=found.unseen,
            ways=None if found.ways is None else found.ways.tolist(),
            shortfall=found.shortfall,
            acceptance=found.acceptance,
            proposals=None if found.proposals is None else ProposalCounts.model_validate(found.proposals),
            seed=query.seed,
            timing_ms=timing,
            **about(served, novelty, warnings),
        )
    )


def _query_of(request: SampleRequest) -> SampleQuery:
    return SampleQuery(
        n=request.n,
        seed=random_seed(request.seed),
        epsilon_sigma=tuple(request.epsilon_sigma),
        start=None if request.start is None else tuple(request.start),
        goal=None if request.goal is None else tuple(request.goal),
        min_confidence=request.min_confidence,
        robot=robot_of(request),
    )
