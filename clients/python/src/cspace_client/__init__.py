"""A client of the inference API of cspace-sampler: samples, confidence and paths for a picture, over HTTP.

``cspace_client.wire`` holds the fields of requests and answers. ``cspace_client.ompl`` plans with OMPL.
"""

from cspace_client.answers import (
    Belief,
    Diagnosis,
    FoundPlan,
    JointSpace,
    Predictions,
    SampleBatch,
)
from cspace_client.client import DEFAULT_TIMEOUT_S, SamplingClient
from cspace_client.errors import (
    ClientError,
    ConfigError,
    PlanningError,
    SamplerAnswerError,
    SamplerError,
    SamplerModelError,
    SamplerUnavailableError,
)
from cspace_client.known import Known
from cspace_client.outcomes import OutcomeSender
from cspace_client.pictures import DepthPictures, Picture, PlanarPicture
from cspace_client.wire import MAX_SAMPLES, Contact, ModelInfo, PictureWarning, PlanQuery, SampleQuery

__all__ = [
    "DEFAULT_TIMEOUT_S",
    "MAX_SAMPLES",
    "Belief",
    "ClientError",
    "ConfigError",
    "Contact",
    "DepthPictures",
    "Diagnosis",
    "FoundPlan",
    "JointSpace",
    "Known",
    "ModelInfo",
    "OutcomeSender",
    "Picture",
    "PictureWarning",
    "PlanQuery",
    "PlanarPicture",
    "PlanningError",
    "Predictions",
    "SampleBatch",
    "SampleQuery",
    "SamplerAnswerError",
    "SamplerError",
    "SamplerModelError",
    "SamplerUnavailableError",
    "SamplingClient",
]
