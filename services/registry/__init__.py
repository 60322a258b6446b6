"""Experiment tracking, the model registry, and promotion: ports, MLflow's adapters, the rules between them.

``tracking.port`` and ``models.port`` are the ports; ``tracking.mlflow_tracking`` and
``models.mlflow_registry`` their adapters, which bring MLflow with them; ``promotion`` records what the
evaluator decides.
"""
