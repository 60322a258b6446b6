"""A client of the inference API of cspace-sampler: samples, beliefs and ways for a picture, over HTTP.

It needs NumPy and httpx alone. ``cspace_client.local`` draws from a bundle in this process where the project
is installed, ``cspace_client.ompl`` plans with OMPL where that is.
"""

from cspace_client.async_sampling_client import AsyncSamplingClient
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
from cspace_client.http.client import DEFAULT_POLICY, DEFAULT_TIMEOUT_S
from cspace_client.joint_space import JointSpace
from cspace_client.model import ModelHead, PictureWarning
from cspace_client.pictures import DepthPictures, Picture
from cspace_client.plans import BelievedWay, Doubt, FoundPlan, NextView, Plan, PlanQuery, PlanWanted
from cspace_client.questions.validity_question import Beliefs
from cspace_client.retries import RetryPolicy
from cspace_client.samples import (
    MAX_SAMPLES,
    SampleBatch,
    SampleQuery,
    Source,
    SourceTiming,
    Wanted,
)
from cspace_client.sampling_client import SamplingClient

__all__ = [
    "DEFAULT_POLICY",
    "DEFAULT_TIMEOUT_S",
    "MAX_SAMPLES",
    "AsyncSamplingClient",
    "Beliefs",
    "BelievedWay",
    "ClientError",
    "ConfigError",
    "DepthPictures",
    "Doubt",
    "FoundPlan",
    "JointSpace",
    "LocalError",
    "ModelHead",
    "NextView",
    "Picture",
    "PictureWarning",
    "Plan",
    "PlanQuery",
    "PlanWanted",
    "PlanningError",
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
    "Wanted",
]
