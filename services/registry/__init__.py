"""Experiment tracking, the model registry, and promotion: ports, MLflow's adapters, the rules between them.

``tracking.port`` and ``models.port`` are the ports; ``tracking.mlflow_tracking`` and
``models.mlflow_registry`` their adapters, which are imported by their own names because they bring MLflow
with them; ``promotion`` records what the evaluator decides.
"""

from services.registry.models.port import ModelRegistry, ModelVersion
from services.registry.names import ALIAS_CHALLENGER, ALIAS_CHAMPION, EXPERIMENT, MODEL_NAME
from services.registry.promotion import (
    Decision,
    champions,
    decisions,
    decisions_of,
    record_decision,
)
from services.registry.tracking.port import RunLog, Tracking

__all__ = [
    "ALIAS_CHALLENGER",
    "ALIAS_CHAMPION",
    "EXPERIMENT",
    "MODEL_NAME",
    "Decision",
    "ModelRegistry",
    "ModelVersion",
    "RunLog",
    "Tracking",
    "champions",
    "decisions",
    "decisions_of",
    "record_decision",
]
