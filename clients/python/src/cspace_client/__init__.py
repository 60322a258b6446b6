"""A client of the inference API of cspace-sampler: samples, confidence and paths for a picture, over HTTP.

It needs NumPy and httpx alone. ``cspace_client.local`` draws from a bundle in this process where the project
is installed, ``cspace_client.ompl`` plans with OMPL where that is.
"""

from cspace_client.client import DEFAULT_POLICY, DEFAULT_TIMEOUT_S, AsyncSamplingClient, SamplingClient
from cspace_client.errors import (
    ClientError,
    ConfigError,
    LocalError,
    PlanningError,
    SamplerAnswerError,
    SamplerError,
    SamplerModelError,
    SamplerUnavailableError,
)
from cspace_client.known import Known
from cspace_client.models import (
    MAX_SAMPLES,
    AlternativePath,
    Belief,
    Contact,
    Diagnosis,
    FoundPlan,
    JointSpace,
    LeastConfidence,
    ModelHead,
    NextView,
    PictureWarning,
    Plan,
    PlanQuery,
    SampleBatch,
    SampleQuery,
    Source,
    SourceTiming,
    SuggestedPose,
    Verdict,
)
from cspace_client.outcomes import OutcomeSender
from cspace_client.pictures import DepthPictures, Picture, PlanarPicture
from cspace_client.requests import Predictions
from cspace_client.transport import RetryPolicy

__all__ = [
    "DEFAULT_POLICY",
    "DEFAULT_TIMEOUT_S",
    "MAX_SAMPLES",
    "AlternativePath",
    "AsyncSamplingClient",
    "Belief",
    "ClientError",
    "ConfigError",
    "Contact",
    "DepthPictures",
    "Diagnosis",
    "FoundPlan",
    "JointSpace",
    "Known",
    "LeastConfidence",
    "LocalError",
    "ModelHead",
    "NextView",
    "OutcomeSender",
    "Picture",
    "PictureWarning",
    "Plan",
    "PlanQuery",
    "PlanarPicture",
    "PlanningError",
    "Predictions",
    "RetryPolicy",
    "SampleBatch",
    "SampleQuery",
    "SamplerAnswerError",
    "SamplerError",
    "SamplerModelError",
    "SamplerUnavailableError",
    "SamplingClient",
    "Source",
    "SourceTiming",
    "SuggestedPose",
    "Verdict",
]
