"""One request from field values to the bytes of its answer; runs in a worker thread, off the event loop."""

import io
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import prod

import numpy as np
from fastapi.responses import Response

from cspace.bundle import Bundle, SampleSet
from cspace.bundle.request import fitted
from cspace.query import SampleQuery
from inference_api.bodies.request_body import RawFields, parse_fields
from inference_api.models.pictures import Prepared
from inference_api.models.served import ServedModel
from inference_api.models.store import ModelStore
from inference_api.pages.model_schemas import ModelInfo, joint_space_info
from inference_api.pages.schemas import PictureWarning, SampleAnswer, ScenarioInfo, TimingMs, warnings_of
from inference_api.pages.validation import validate_request
from inference_api.telemetry.observer import Sampled
from inference_api.turns.costs import rows_of
from inference_api.turns.searching import paid
from inference_api.turns.turns import Turn
from services.registry.references import ModelReference

NPY = "application/x-npy"
# Proxies take 4 KiB of headers.
MAX_WARNINGS = 2048


@dataclass(frozen=True, slots=True)
class Answer:
    """What the sampler found, before it is written as JSON or ``.npy``.

    Args:
        served: the model that answered.
        found: its samples.
        novelty: of the picture; None where the model does not tell.
        warnings: of the picture.
        seed: the seed that was used.
        timing: where the time went.
    """

    served: ServedModel
    found: SampleSet
    novelty: float | None
    warnings: list[PictureWarning]
    seed: int
    timing: TimingMs


@dataclass(frozen=True, slots=True)
class SampleQuestion:
    """A valid request for samples; an :class:`~inference_api.pages.exchange.Question`.

    Args:
        store: where pictures are known and observers told.
        reference: the model that it names.
        image: the picture's file.
        query: what is asked.
        npy: whether the client prefers the samples alone as ``.npy``.
        began: ``time.perf_counter()`` when the request came in, s.
    """

    store: ModelStore
    reference: ModelReference
    image: bytes
    query: SampleQuery
    npy: bool
    began: float

    def answer(self, served: ServedModel, turn: Turn) -> Response:
        """Sample and write.

        Raises:
            CspaceError: as the contract's table of errors.
            ClientDisconnect: the client has gone away.
        """
        answer = self._sample(served, turn)
        self.store.observer.sampled(sampled(answer, self.query.n))
        return npy_response(answer) if self.npy else json_response(answer)

    def _sample(self, served: ServedModel, turn: Turn) -> Answer:
        bundle = served.bundle
        query = fitted(self.query, bundle.spec, has_validity=bundle.has_validity)
        with paid(turn, bundle.spec, query) as between:
            prepared = prepared_picture(self.store, bundle, self.image, turn)
            # A ``.npy`` holds samples alone: nobody would see the scores of those that are not filtered.
            found = bundle.answer(prepared.picture, query, tell_confidence=not self.npy, between=between)
        timing = TimingMs(
            decode=prepared.decode_ms,
            encode=prepared.encode_ms,
            generate=found.generate_ms,
            total=1e3 * (time.perf_counter() - self.began),
        )
        # Without a confidence to reach all are taken.
        warnings = warnings_of(prepared.findings_with(bundle.spec.world, colliding=1.0 - found.acceptance))
        return Answer(served, found, prepared.picture.novelty, warnings, self.query.seed, timing)


def read_question(
    store: ModelStore, fields: RawFields, turn: Turn, *, npy: bool, began: float
) -> SampleQuestion:
    """Parse and validate.

    Args:
        store: where the models are.
        fields: the body as it was read.
        turn: told what reading costs.
        npy: as :class:`SampleQuestion` has it.
        began: likewise.

    Raises:
        CspaceError: as the contract's table of errors.
    """
    turn.spend(rows_of(json_bytes=fields.json_bytes))
    request = validate_request(parse_fields(fields))
    named = request.model if "model" in request.model_fields_set else store.model_name
    reference = ModelReference.parse(named)
    return SampleQuestion(store, reference, request.picture(), request.query(), npy, began)


def prepared_picture(store: ModelStore, bundle: Bundle, image: bytes, turn: Turn) -> Prepared:
    """A picture as a bundle takes it; one that is not known is paid for, and read in parts.

    Raises:
        InputError: not a picture that is accepted.
        BundleError: the encoder fails.
        ClientDisconnect: the client has gone away.
    """
    values = prod(bundle.spec.world.sensor.picture_shape)

    def spend(pixels: int) -> None:
        turn.spend(rows_of(pixels=pixels, values=values))

    return store.pictures.get(bundle, image, spend, turn.between)


def json_response(answer: Answer) -> Response:
    """The whole answer as JSON."""
    found, spec = answer.found, answer.served.bundle.spec
    # Constructed, not validated: the lists come from an array, and walking them costs more than sampling.
    body = SampleAnswer.model_construct(
        samples=found.samples.tolist(),
        confidence=None if found.confidence is None else found.confidence.tolist(),
        unseen=None if found.unseen is None else found.unseen.tolist(),
        ways=None if found.ways is None else found.ways.tolist(),
        shortfall=found.shortfall,
        acceptance=found.acceptance,
        scenario=ScenarioInfo(novelty=answer.novelty),
        warnings=answer.warnings,
        joint_space=joint_space_info(spec.joint_space),
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
    headers = model_headers(served, answer.novelty, answer.warnings) | {
        "X-Seed": str(answer.seed),
        "X-Shortfall": str(answer.found.shortfall),
        "X-Acceptance": f"{answer.found.acceptance:.6g}",
        "Server-Timing": timing,
    }
    return Response(npy_head(samples.shape) + samples.tobytes(), headers=headers, media_type=NPY)


def model_headers(
    served: ServedModel, novelty: float | None, warnings: Sequence[PictureWarning]
) -> dict[str, str]:
    """What a ``.npy`` cannot hold of the model that answered and of the picture."""
    headers = {
        "X-Model-Name": served.name,
        "X-Model-Version": str(served.version),
        "X-Model-Digest": served.bundle.digest,
        "X-Robot": served.bundle.robot,
        "X-Alias-Confirmed": "true" if served.confirmed else "false",
        "X-Joint-Space": json.dumps(served.bundle.spec.joint_space, separators=(",", ":")),
        "X-Warnings": warnings_text(warnings),
    }
    return headers if novelty is None else headers | {"X-Novelty": f"{novelty:.6g}"}


def warnings_text(warnings: Sequence[PictureWarning]) -> str:
    """Warnings as ASCII JSON of at most :data:`MAX_WARNINGS` characters: the last ones lose their words."""
    told = [one.model_dump() for one in warnings]
    for one in reversed(told):
        if len(json.dumps(told)) <= MAX_WARNINGS:
            break
        one["message"] = ""
    return json.dumps(told, separators=(",", ":"))


@lru_cache(maxsize=64)
def npy_head(shape: tuple[int, ...]) -> bytes:
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
        robot=served.bundle.robot,
        alias_confirmed=served.confirmed,
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
