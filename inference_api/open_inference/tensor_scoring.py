"""Whether configurations are free, asked by the Open Inference Protocol: an input beside a picture's."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from fastapi.responses import Response
from numpy.typing import NDArray

from cspace.bundle.request import fitted_configurations, require_robot
from cspace.errors import InputError
from cspace.query import MAX_SAMPLES, SampleQuery
from cspace.world import TensorInput
from inference_api.models.served import ServedModel
from inference_api.open_inference.picture_tensors import read_pictures, require_fitting
from inference_api.open_inference.tensor_answer import answer_of
from inference_api.open_inference.tensor_question import TensorQuestion
from inference_api.pages.schemas import QueryFields
from inference_api.pages.validation import validate_fields
from inference_api.telemetry.observer import Scored
from inference_api.turns.costs import rows_of
from inference_api.turns.turns import Turn

CONFIGURATIONS = "configurations"
_PARAMETERS = ("robot",)


def configurations_input(dim: int) -> TensorInput:
    """Configurations of a robot with so many joints."""
    return TensorInput(CONFIGURATIONS, "float32", ("n", dim), most=MAX_SAMPLES, optional=True)


class ScoringQuestion(TensorQuestion):
    """A request that has configurations among its tensors; an answer has their confidence."""

    __slots__ = ()

    def answer(self, served: ServedModel, turn: Turn) -> Response:
        """Score and write.

        Raises:
            CspaceError: as the contract's table of errors.
            ClientDisconnect: the client has gone away.
        """
        bundle = served.bundle
        spec = bundle.spec
        require_robot(self.query.robot, spec)
        pictures = dict(self.tensors)
        given = pictures.pop(CONFIGURATIONS)
        require_fitting(configurations_input(spec.dim), given)
        configurations = fitted_configurations(given, spec)
        read = read_pictures(spec.world, pictures, turn)
        images = read.images
        if len(images) != 1:
            raise InputError(
                "configurations are asked about in one picture",
                expected="one picture",
                got=f"{len(images)}",
                remedy="send a request for each picture",
            )
        turn.spend(rows_of(drawn=len(configurations)))
        picture = self.store.pictures.of_pixels(bundle, images[0]).picture
        confidence, unseen = bundle.believe(picture, configurations, turn.between)
        self.store.observer.scored(
            Scored(f"{served.name}/{served.version}", served.fallback, len(confidence))
        )
        arrays: dict[str, NDArray[Any]] = {"confidence": confidence}
        arrays |= {} if unseen is None else {"unseen": unseen}
        if picture.novelty is not None:
            arrays["novelty"] = np.array([picture.novelty], dtype=np.float32)
        return answer_of(served, self.request, arrays, binary=self.binary, findings=read.findings)


def scoring_query(fields: Mapping[str, object]) -> SampleQuery:
    """What a request with configurations has among its parameters but for the outputs' own.

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
    return validate_fields(QueryFields, fields).query()
