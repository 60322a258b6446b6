"""One request from field values to the bytes of its answer; runs in a worker thread, off the event loop."""

import io
import secrets
import time
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from fastapi.responses import Response

from cspace.bundle import SampleSet
from inference_api.model_store import ModelStore, ServedModel
from inference_api.references import ModelReference
from inference_api.request_body import RawFields, parse_fields
from inference_api.schemas import (
    JointSpaceInfo,
    ModelInfo,
    SampleAnswer,
    SampleRequest,
    ScenarioInfo,
    TimingMs,
)
from inference_api.telemetry.observer import Sampled
from inference_api.validation import validate_request

NPY = "application/x-npy"


@dataclass(frozen=True, slots=True)
class Answer:
    """What the sampler found, before it is written as JSON or ``.npy``.

    Args:
        served: the model that answered.
        found: its samples.
        novelty: of the picture; None where the model does not tell.
        seed: the seed that was used.
        timing: where the time went.
    """

    served: ServedModel
    found: SampleSet
    novelty: float | None
    seed: int
    timing: TimingMs


def answer_request(store: ModelStore, fields: RawFields, *, npy: bool, began: float) -> Response:
    """Parse, validate, sample and write.

    Args:
        store: where the models are.
        fields: the body as it was read.
        npy: whether the client prefers the samples alone as ``.npy``.
        began: ``time.perf_counter()`` when the request came in, s.

    Raises:
        CspaceError: as the contract's table of errors.
    """
    values = parse_fields(fields)
    # A ``.npy`` holds samples alone: nobody would see the scores of those that are not filtered.
    answer = sample(store, validate_request(values), began, tell_confidence=not npy)
    return npy_response(answer) if npy else json_response(answer)


def sample(
    store: ModelStore, request: SampleRequest, began: float, *, tell_confidence: bool = True
) -> Answer:
    """Answer a valid request; as :meth:`cspace.bundle.Bundle.sample` has it, scored for who is told."""
    named = request.model if "model" in request.model_fields_set else store.model_name
    served = store.resolve(ModelReference.parse(named))
    prepared = store.pictures.get(served.bundle, request.image)
    seed = secrets.randbits(64) if request.seed is None else request.seed
    found = served.bundle.sample(
        prepared.picture,
        request.n,
        seed,
        epsilon_sigma=request.epsilon_sigma,
        start=request.start,
        goal=request.goal,
        min_confidence=request.min_confidence,
        tell_confidence=tell_confidence,
    )
    timing = TimingMs(
        decode=prepared.decode_ms,
        encode=prepared.encode_ms,
        generate=found.generate_ms,
        total=1e3 * (time.perf_counter() - began),
    )
    answer = Answer(served, found, prepared.picture.novelty, seed, timing)
    store.observer.sampled(sampled(answer, request.n))
    return answer


def json_response(answer: Answer) -> Response:
    """The whole answer as JSON."""
    found, spec = answer.found, answer.served.bundle.spec
    # Constructed, not validated: the lists come from an array, and walking them costs more than sampling.
    body = SampleAnswer.model_construct(
        samples=found.samples.tolist(),
        confidence=None if found.confidence is None else found.confidence.tolist(),
        shortfall=found.shortfall,
        acceptance=found.acceptance,
        scenario=ScenarioInfo(novelty=answer.novelty),
        joint_space=JointSpaceInfo(**spec.joint_space),
        model=model_info(answer.served),
        seed=str(answer.seed),
        timing_ms=answer.timing,
    )
    return Response(body.model_dump_json(), media_type="application/json")


def npy_response(answer: Answer) -> Response:
    """The samples alone as a float32 ``.npy``, the rest in headers."""
    samples = np.ascontiguousarray(answer.found.samples, dtype="<f4")
    served = answer.served
    timing = ", ".join(f"{name};dur={value:.3f}" for name, value in answer.timing.model_dump().items())
    headers = {
        "X-Model-Name": served.name,
        "X-Model-Version": str(served.version),
        "X-Model-Digest": served.bundle.digest,
        "X-Seed": str(answer.seed),
        "X-Shortfall": str(answer.found.shortfall),
        "X-Acceptance": f"{answer.found.acceptance:.6g}",
        "Server-Timing": timing,
    }
    if answer.novelty is not None:
        headers["X-Novelty"] = f"{answer.novelty:.6g}"
    return Response(_npy_head(samples.shape) + samples.tobytes(), headers=headers, media_type=NPY)


@lru_cache(maxsize=64)
def _npy_head(shape: tuple[int, ...]) -> bytes:
    """What stands before the numbers in the ``.npy`` of a float32 array in C order."""
    buffer = io.BytesIO()
    described = {"descr": "<f4", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(buffer, described)
    return buffer.getvalue()


def sampled(answer: Answer, n: int) -> Sampled:
    """An answer to a request for ``n`` samples as observers are told of it."""
    served, found = answer.served, answer.found
    return Sampled(
        model=f"{served.name}/{served.version}",
        fallback=served.fallback,
        n=n,
        seed=answer.seed,
        shortfall=found.shortfall,
        acceptance=found.acceptance,
        stages_s={stage: 1e-3 * value for stage, value in answer.timing.model_dump().items()},
    )


def model_info(served: ServedModel) -> ModelInfo:
    """A served model as answers describe it."""
    return ModelInfo(
        name=served.name,
        version=served.version,
        alias=served.alias,
        run_id=served.run_id,
        digest=served.bundle.digest,
        fallback=served.fallback,
    )


def prefers_npy(accept: str | None) -> bool:
    """Whether an ``Accept`` header ranks ``.npy`` above JSON; it has to name it."""
    npy, other = 0.0, 0.0
    for entry in (accept or "").split(","):
        media_type, *parameters = (part.strip().lower() for part in entry.split(";"))
        quality = _quality(parameters)
        if media_type == NPY:
            npy = max(npy, quality)
        elif media_type == "application/json":
            other = max(other, quality)
    return npy > 0.0 and npy >= other


def _quality(parameters: list[str]) -> float:
    for parameter in parameters:
        name, _, value = parameter.partition("=")
        if name.strip() == "q":
            try:
                return float(value)
            except ValueError:
                return 0.0
    return 1.0
