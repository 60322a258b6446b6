"""One request of the Open Inference Protocol from the bytes of its body to those of its answer."""

import time
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from fastapi.responses import Response
from numpy.typing import NDArray

from cspace.bundle import Bundle, SampleSet
from cspace.bundle.request import fitted
from cspace.errors import InputError
from cspace.query import MAX_SAMPLES, MAX_SEED, SampleQuery
from inference_api.models.pictures import PictureCache, Prepared
from inference_api.models.served import ServedModel
from inference_api.models.store import ModelStore
from inference_api.open_inference.picture_tensors import read_pictures
from inference_api.open_inference.tensor_answer import answer_of
from inference_api.open_inference.tensor_question import TensorQuestion
from inference_api.open_inference.tensor_request import read_request, split_parameters
from inference_api.open_inference.tensor_scoring import CONFIGURATIONS, ScoringQuestion, scoring_query
from inference_api.open_inference.tensors import read_tensors, split_body
from inference_api.pages.schemas import QueryFields
from inference_api.pages.validation import validate_fields
from inference_api.telemetry.observer import Sampled
from inference_api.turns.costs import rows_of
from inference_api.turns.searching import paid
from inference_api.turns.turns import Turn
from services.registry.references import ModelReference, is_shipped


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """Samples for one or several pictures.

    Args:
        found: one set for each picture.
        seeds: of each.
        novelties: of each; empty where the model does not tell.
        encode_s: time in the encoder; 0 where all pictures were known.
    """

    found: list[SampleSet]
    seeds: list[int]
    novelties: list[float] = field(default_factory=list)
    encode_s: float = 0.0


def reference_of(model: str, version: str | None = None) -> ModelReference:
    """The model that an address names; shipped ones have the version 0.

    Raises:
        InputError: there are no such names.
    """
    if version is None or (is_shipped(model) and version == "0"):
        return ModelReference.parse(model)
    return ModelReference.parse(f"{model}/{version}")


class InferenceQuestion(TensorQuestion):
    """A request for samples; an :class:`~inference_api.pages.exchange.Question`."""

    __slots__ = ()

    def answer(self, served: ServedModel, turn: Turn) -> Response:
        """Sample and write.

        Raises:
            CspaceError: as the contract's table of errors.
            ClientDisconnect: the client has gone away.
        """
        bundle = served.bundle
        query = fitted(self.query, bundle.spec, has_validity=bundle.has_validity)
        read = read_pictures(bundle.spec.world, self.tensors, turn)
        drawn = draw(bundle, read.images, query, self.store.pictures, turn)
        spent_s = time.perf_counter() - self.began
        self.store.observer.sampled(sampled(served, drawn, self.query.n, spent_s))
        arrays = output_arrays(drawn)
        return answer_of(served, self.request, arrays, binary=self.binary, findings=read.findings)


def read_inference(
    store: ModelStore, reference: ModelReference, body: bytes, json_length: str | None, turn: Turn
) -> InferenceQuestion | ScoringQuestion:
    """Parse and validate.

    Args:
        store: where the models are.
        reference: the model.
        body: of the request.
        json_length: of its JSON object, as the header has it; None for all of the body.
        turn: told what reading costs, and asked between its parts.

    Raises:
        CspaceError: as the contract's table of errors.
    """
    began = time.perf_counter()
    parts = split_body(body, json_length)
    turn.spend(rows_of(json_bytes=len(parts.head)))
    request = read_request(parts.head)
    turn.between()
    tensors = read_tensors(request.inputs, parts.tail)
    turn.between()
    binary, fields = split_parameters(request.parameters)
    if CONFIGURATIONS in tensors:
        query = scoring_query(fields)
        return ScoringQuestion(store, reference, request, tensors, query, binary, began)
    query = validate_fields(QueryFields, fields).query()
    return InferenceQuestion(store, reference, request, tensors, query, binary, began)


def draw(
    bundle: Bundle, images: NDArray[np.uint8], query: SampleQuery, known: PictureCache, turn: Turn
) -> Drawn:
    """Samples for each picture as it would get them alone, with the seeds seed, seed + 1, ... modulo 2^64.

    Args:
        bundle: the model.
        images: uint8 (b, ...), as the model's world has pictures.
        query: what is asked for the first, and but for the seed for all.
        known: pictures that are encoded already.
        turn: told the cost, and asked between pictures.

    Raises:
        InputError: these are more samples than one request may ask for, or a value does not fit the model.
    """
    if query.n * len(images) > MAX_SAMPLES:
        raise InputError(
            "these are too many samples",
            expected=f"n times the number of pictures at most {MAX_SAMPLES}",
            got=f"{query.n} times {len(images)}",
            remedy="ask for fewer at a time",
        )
    seeds = [(query.seed + index) % (MAX_SEED + 1) for index in range(len(images))]
    prepared: list[Prepared] = []
    found: list[SampleSet] = []
    with paid(turn, bundle.spec, query, len(images)) as between:
        for image, seed in zip(images, seeds, strict=True):
            turn.between()
            prepared.append(known.of_pixels(bundle, image))
            found.append(bundle.answer(prepared[-1].picture, replace(query, seed=seed), between=between))
    novelties = [one.picture.novelty for one in prepared if one.picture.novelty is not None]
    return Drawn(found, seeds, novelties, 1e-3 * sum(one.encode_ms for one in prepared))


def sampled(served: ServedModel, drawn: Drawn, n: int, total_s: float) -> Sampled:
    """An answer with ``n`` samples asked for each picture as observers are told of it; nothing is decoded."""
    found = drawn.found
    return Sampled(
        model=f"{served.name}/{served.version}",
        fallback=served.fallback,
        n=n * len(found),
        seed=drawn.seeds[0],
        shortfall=sum(one.shortfall for one in found),
        acceptance=sum(one.acceptance for one in found) / len(found),
        stages_s={
            "encode": drawn.encode_s,
            "generate": 1e-3 * sum(one.generate_ms for one in found),
            "total": total_s,
        },
    )


def output_arrays(drawn: Drawn) -> dict[str, NDArray[Any]]:
    """Every output by name; several pictures are cut to the number of samples of the one that has fewest.

    ``samples`` (n', d) for one picture and (b, n', d) for several, ``confidence`` likewise without the last
    axis where the model has a validity head, ``unseen`` and ``ways`` like it where they are told,
    ``shortfall`` (b,): n minus what each picture had before the cut, so that n' is n minus the largest,
    ``novelty`` (b,) where the model tells, and ``seed`` (b,).
    """
    found = drawn.found
    count = min(len(one.samples) for one in found)
    arrays: dict[str, NDArray[Any]] = {"samples": np.stack([one.samples[:count] for one in found])}
    scores = [one.confidence[:count] for one in found if one.confidence is not None]
    arrays |= {"confidence": np.stack(scores)} if scores else {}
    unseen = [one.unseen[:count] for one in found if one.unseen is not None]
    arrays |= {"unseen": np.stack(unseen)} if unseen else {}
    ways = [one.ways[:count] for one in found if one.ways is not None]
    arrays |= {"ways": np.stack(ways)} if ways else {}
    if len(found) == 1:
        arrays = {name: array[0] for name, array in arrays.items()}
    arrays["shortfall"] = np.array([one.shortfall for one in found], dtype=np.int32)
    if drawn.novelties:
        arrays["novelty"] = np.array(drawn.novelties, dtype=np.float32)
    arrays["seed"] = np.array(drawn.seeds, dtype=np.uint64)
    return arrays
