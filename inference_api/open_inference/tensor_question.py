"""What has been read of a request of the Open Inference Protocol, whatever it asks."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from cspace.query import SampleQuery
from inference_api.models.store import ModelStore
from inference_api.open_inference.tensor_schemas import InferenceRequest
from services.registry.references import ModelReference


@dataclass(frozen=True, slots=True, eq=False)
class TensorQuestion:
    """Half of a :class:`~inference_api.pages.exchange.Question`: all but its answer.

    Args:
        store: where pictures are known and observers told.
        reference: the model that it names.
        request: the JSON object.
        tensors: its inputs by name.
        query: whose robot it is, how sure the model has to be, and what samples are wanted.
        binary: whether outputs come as bytes unless they are asked for otherwise.
        began: ``time.perf_counter()`` when the request was read, s.
    """

    store: ModelStore
    reference: ModelReference
    request: InferenceRequest
    tensors: Mapping[str, NDArray[Any]]
    query: SampleQuery
    binary: bool
    began: float
