"""Whether configurations are free, asked by the Open Inference Protocol: an input beside a picture's."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from fastapi.responses import Response
from numpy.typing import NDArray

from cspace.bundle.request import fitted_configurations, require_robot
from cspace.errors import InputError
from cspace.query import MAX_SAMPLES, SampleQuery
from cspace.world import TensorInput
from inference_api.models.served import ServedModel
from inference_api.models.store import ModelStore
from inference_api.open_inference.picture_tensors import read_pictures, require_fitting
from inference_api.open_inference.tensor_answer import answer_of
from inference_api.open_inference.tensor_schemas import InferenceRequest
from inference_api.pages.schemas import QueryFields
from inference_api.pages.validation import validate_fields
from inference_api.telemetry.observer import Scored
from inference_api.turns.turns import Turn
from services.registry.references import ModelReference

CONFIGURATIONS = "configurations"
_PARAMETERS = ("robot", "require_confirmed")


def configurations_input(dim: int) -> TensorInput:
    """Configurations of a robot with so many joints."""
    return TensorInput(CONFIGURATIONS, "float32", ("n", dim), most=MAX_SAMPLES, optional=True)


@dataclass(frozen=True, slots=True, eq=False)
class ScoringQuestion:
    """A request whose tensors are read; an :class:`~inference_api.pages.exchange.Question`.

    Args:
        store: where pictures are known and observers told.
        reference: the model that it names.
        request: the JSON object.
        pictures: its inputs by name, but for the configurations.
        configurations: not held against the model's robot yet.
        query: whose robot it is, and how sure the model has to be.
        binary: whether outputs come as bytes unless they are asked for otherwise.
        began: ``time.perf_counter()`` when the request was read, s.
    """

    store: ModelStore
    reference: ModelReference
    request: InferenceRequest
    pictures: Mapping[str, NDArray[Any]]
    configurations: NDArray[Any]
    query: SampleQuery
    binary: bool
    began: float

    @property
    def require_confirmed(self) -> bool:
        """See :class:`~inference_api.pages.exchange.Question`."""
        return self.query.require_confirmed

    def answer(self, served: ServedModel, turn: Turn) -> Response:
        """Score and write.

        Raises:
            CspaceError: as the contract's table of errors.
            ClientDisconnect: the client has gone away.
        """
        bundle = served.bundle
        spec = bundle.spec
        require_robot(self.query.robot, spec)
        require_fitting(configurations_input(spec.dim), self.configurations)
        configurations = fitted_configurations(self.configurations, spec)
        images = read_pictures(spec.world, self.pictures)
        if len(images) != 1:
            raise InputError(
                "configurations are asked about in one picture",
                expected="one picture",
                got=f"{len(images)}",
                remedy="send a request for each picture",
            )
        turn.spend(float(len(configurations)))
        picture = self.store.pictures.of_pixels(bundle, images[0]).picture
        confidence, unseen = bundle.believe(picture, configurations, turn.between)
        self.store.observer.scored(
            Scored(f"{served.name}/{served.version}", served.fallback, len(confidence))
        )
        arrays: dict[str, NDArray[Any]] = {"confidence": confidence}
        arrays |= {} if unseen is None else {"unseen": unseen}
        if picture.novelty is not None:
            arrays["novelty"] = np.array([picture.novelty], dtype=np.float32)
        return answer_of(served, self.request, arrays, binary=self.binary)


def scoring(
    store: ModelStore,
    reference: ModelReference,
    request: InferenceRequest,
    tensors: Mapping[str, NDArray[Any]],
    fields: Mapping[str, object],
    *,
    binary: bool,
    began: float,
) -> ScoringQuestion:
    """A request that has configurations among its tensors.

    Args:
        store: as :class:`ScoringQuestion` has it.
        reference: likewise.
        request: likewise.
        tensors: all its inputs by name.
        fields: its parameters but for the outputs' own.
        binary: as :class:`ScoringQuestion` has it.
        began: likewise.

    Raises:
        InputError: a parameter is one of samples, or has a wrong value.
    """
    others = sorted(set(fields) - set(_PARAMETERS))
    if others:
        raise InputError(
            f"{others[0]} does not go with the input {CONFIGURATIONS}",
            expected=f"no parameters but {' and '.join(_PARAMETERS)}",
            got=others[0],
            remedy=f"leave it out, or ask for samples without the input {CONFIGURATIONS}",
        )
    query = validate_fields(QueryFields, fields).query()
    pictures = {name: array for name, array in tensors.items() if name != CONFIGURATIONS}
    return ScoringQuestion(store, reference, request, pictures, tensors[CONFIGURATIONS], query, binary, began)
