"""Requests and answers of the Open Inference Protocol as types; the OpenAPI document is made from them."""

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

Parameter = bool | int | float | str
Parameters = dict[str, Parameter]

MAX_RANK = 8
_STRICT = ConfigDict(extra="forbid", strict=True, frozen=True, protected_namespaces=())


class InputTensor(BaseModel):
    """A tensor of a request; its numbers are in ``data``, or behind the JSON object."""

    model_config = _STRICT

    name: str = Field(max_length=100)
    datatype: str = Field(max_length=20)
    shape: list[int] = Field(max_length=MAX_RANK)
    parameters: Parameters = Field({}, description="`binary_data_size`, in bytes, for a binary tensor.")
    data: list[Any] | None = Field(None, description="The numbers by rows, flat or nested.")


class RequestedOutput(BaseModel):
    """A tensor that is asked for."""

    model_config = _STRICT

    name: str = Field(max_length=100)
    parameters: Parameters = Field({}, description="`binary_data`: whether it comes as bytes.")


class InferenceRequest(BaseModel):
    """The JSON object of a request; unknown members and parameters are errors."""

    model_config = _STRICT

    id: str | None = Field(None, max_length=1000, description="Comes back in the answer.")
    model_name: str | None = Field(None, description="Not looked at: the address names the model.")
    model_version: str | None = Field(None, description="Not looked at, as `model_name`.")
    parameters: Parameters = Field(
        {},
        description="`n`, `seed`, `min_confidence`, `robot` and `epsilon_sigma` as in `POST /sample`"
        "; `start`, `goal` and several `epsilon_sigma` as a JSON array in a string; "
        "`binary_data_output`: whether outputs come as bytes.",
    )
    inputs: list[InputTensor] = Field(min_length=1, max_length=16)
    outputs: list[RequestedOutput] | None = Field(None, max_length=16, description="All when absent.")


class OutputTensor(BaseModel):
    """A tensor of an answer."""

    name: str
    datatype: str
    shape: list[int]
    parameters: Parameters | None = Field(None, description="`binary_data_size`, in bytes.")
    data: list[float] | None = Field(None, description="The numbers by rows, flat.")


class InferenceAnswer(BaseModel):
    """The JSON object of an answer."""

    model_config = ConfigDict(protected_namespaces=())

    model_name: str
    model_version: str
    id: str | None = None
    parameters: Parameters = Field(
        description="`digest`, `fallback`, `robot` and `alias_confirmed` as in `POST /sample`."
    )
    outputs: list[OutputTensor]


class TensorMetadata(BaseModel):
    """Name, type and shape of a tensor; -1 stands for any size."""

    name: str
    datatype: str
    shape: list[int]


class ModelMetadata(BaseModel):
    """What a model takes and gives."""

    name: str
    versions: list[str]
    platform: str
    inputs: list[TensorMetadata]
    outputs: list[TensorMetadata]


class ServerMetadata(BaseModel):
    """The server."""

    name: str
    version: str
    extensions: list[str]


class ServerLive(BaseModel):
    """The process answers."""

    live: bool = True


class ServerReady(BaseModel):
    """Samples can be asked for."""

    ready: bool = True


class ModelReady(BaseModel):
    """The model can be asked for samples."""

    name: str
    ready: bool = True


class ProtocolError(BaseModel):
    """Why there is no answer."""

    error: str
