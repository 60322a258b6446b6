"""Whether configurations are free, from field values to the bytes of the answer; runs in a worker thread."""

import time
from dataclasses import dataclass
from itertools import chain

import numpy as np
from fastapi.responses import Response
from numpy.typing import NDArray

from cspace.bundle.request import fitted_configurations, require_robot
from cspace.errors import InputError
from cspace.files import read_npy
from cspace.query import MAX_SAMPLES
from inference_api.bodies.request_body import VALIDITY_FORM, RawFields, parse_fields
from inference_api.models.served import ServedModel
from inference_api.models.store import ModelStore
from inference_api.pages.model_schemas import joint_space_info
from inference_api.pages.sampling import NPY, model_headers, model_info, npy_head, prepared_picture
from inference_api.pages.schemas import PictureWarning, ScenarioInfo, warnings_of
from inference_api.pages.validation import validate_fields
from inference_api.pages.validity_schemas import ScoreTimingMs, ValidityAnswer, ValidityRequest
from inference_api.telemetry.observer import Scored
from inference_api.turns.costs import rows_of
from inference_api.turns.turns import Turn
from services.registry.references import ModelReference

# Fewer configurations may well all collide.
MANY_ROWS = 20
_TYPES = ("<f4", "<f8")


@dataclass(frozen=True, slots=True)
class Validity:
    """What a model holds of configurations, before it is written as JSON or ``.npy``.

    Args:
        served: the model that answered.
        confidence: (n,) float32.
        unseen: (n,) float32, share of the robot that no picture shows; None in worlds that are seen whole.
        novelty: of the picture; None where the model does not tell.
        warnings: of the picture.
        timing: where the time went.
    """

    served: ServedModel
    confidence: NDArray[np.float32]
    unseen: NDArray[np.float32] | None
    novelty: float | None
    warnings: list[PictureWarning]
    timing: ScoreTimingMs


@dataclass(frozen=True, slots=True, eq=False)
class ValidityQuestion:
    """A valid request; an :class:`~inference_api.pages.exchange.Question`.

    Args:
        store: where pictures are known and observers told.
        reference: the model that it names.
        image: the picture's file.
        configurations: (n, d) rad, not held against the model's robot yet.
        robot: whose they are; None for the model's.
        npy: whether the client prefers a ``.npy``.
        began: ``time.perf_counter()`` when the request came in, s.
    """

    store: ModelStore
    reference: ModelReference
    image: bytes
    configurations: NDArray[np.floating]
    robot: str | None
    npy: bool
    began: float

    def answer(self, served: ServedModel, turn: Turn) -> Response:
        """Score and write.

        Raises:
            CspaceError: as the contract's table of errors.
            ClientDisconnect: the client has gone away.
        """
        found = self._score(served, turn)
        name = f"{served.name}/{served.version}"
        self.store.observer.scored(Scored(name, served.fallback, len(found.confidence)))
        return _npy_response(found) if self.npy else _json_response(found)

    def _score(self, served: ServedModel, turn: Turn) -> Validity:
        bundle = served.bundle
        require_robot(self.robot, bundle.spec)
        configurations = fitted_configurations(self.configurations, bundle.spec)
        turn.spend(rows_of(drawn=len(configurations)))
        prepared = prepared_picture(self.store, bundle, self.image, turn)
        scoring = time.perf_counter()
        confidence, unseen = bundle.believe(prepared.picture, configurations, turn.between)
        ended = time.perf_counter()
        timing = ScoreTimingMs(
            decode=prepared.decode_ms,
            encode=prepared.encode_ms,
            score=1e3 * (ended - scoring),
            total=1e3 * (ended - self.began),
        )
        colliding = float((confidence < 0.5).mean()) if len(confidence) >= MANY_ROWS else 0.0
        warnings = warnings_of(prepared.findings_with(bundle.spec.world, colliding=colliding))
        return Validity(served, confidence, unseen, prepared.picture.novelty, warnings, timing)


def read_validity(
    store: ModelStore, fields: RawFields, turn: Turn, *, npy: bool, began: float
) -> ValidityQuestion:
    """Parse and validate.

    Args:
        store: where the models are.
        fields: the body as it was read.
        turn: told what reading costs, and asked between its parts.
        npy: as :class:`ValidityQuestion` has it.
        began: likewise.

    Raises:
        CspaceError: as the contract's table of errors.
    """
    turn.spend(rows_of(json_bytes=fields.json_bytes))
    values = parse_fields(fields, VALIDITY_FORM)
    turn.between()
    request = validate_fields(ValidityRequest, values)
    turn.between()
    named = request.model if "model" in request.model_fields_set else store.model_name
    return ValidityQuestion(
        store,
        ModelReference.parse(named),
        request.picture(),
        _array_of(request.configurations),
        request.robot,
        npy,
        began,
    )


def _array_of(given: bytes | tuple[tuple[float, ...], ...]) -> NDArray[np.floating]:
    """(n, d), of a ``.npy`` file or of rows."""
    if not isinstance(given, bytes):
        lengths = {len(row) for row in given}
        if len(lengths) > 1:
            raise _wrong(f"rows of {min(lengths)} to {max(lengths)}")
        # Several times as fast as to look into each row for its type.
        flat = np.fromiter(chain.from_iterable(given), np.float64, sum(map(len, given)))
        return flat.reshape(len(given), -1)
    try:
        found = read_npy(given, _TYPES, 2)
    except ValueError as error:
        raise _wrong(str(error)[:200]) from error
    if not 1 <= len(found) <= MAX_SAMPLES:
        raise _wrong(f"{len(found)} rows")
    return found


def _wrong(got: str) -> InputError:
    return InputError(
        "configurations are wrong",
        expected=f"1 to {MAX_SAMPLES} rows of as many angles in rad: JSON, or a .npy of float32 or float64",
        got=got,
        remedy="numpy.save(file, array) writes such a file",
    )


def _json_response(found: Validity) -> Response:
    spec = found.served.bundle.spec
    # Constructed, not validated: the list comes from an array.
    body = ValidityAnswer.model_construct(
        confidence=found.confidence.tolist(),
        unseen=None if found.unseen is None else found.unseen.tolist(),
        threshold=spec.confidence_threshold,
        scenario=ScenarioInfo(novelty=found.novelty),
        warnings=found.warnings,
        joint_space=joint_space_info(spec.joint_space),
        model=model_info(found.served),
        timing_ms=found.timing,
    )
    return Response(body.model_dump_json(), media_type="application/json")


def _npy_response(found: Validity) -> Response:
    """(n, 2) float32: confidence, and the unseen share, NaN where the world is seen whole."""
    served, spec = found.served, found.served.bundle.spec
    columns = np.full((len(found.confidence), 2), np.nan, dtype="<f4")
    columns[:, 0] = found.confidence
    if found.unseen is not None:
        columns[:, 1] = found.unseen
    timing = ", ".join(f"{name};dur={value:.3f}" for name, value in found.timing.model_dump().items())
    headers = model_headers(served, found.novelty, found.warnings) | {"Server-Timing": timing}
    if spec.confidence_threshold is not None:
        headers["X-Threshold"] = f"{spec.confidence_threshold:.6g}"
    return Response(npy_head(columns.shape) + columns.tobytes(), headers=headers, media_type=NPY)
