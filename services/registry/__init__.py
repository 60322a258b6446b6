"""Experiment tracking, the model registry, and promotion: ports, MLflow's adapters, the rules between them.

``ports`` are the ports; ``mlflow_tracking`` and ``mlflow_registry`` their adapters, which bring MLflow with
them; ``promotion`` records what the evaluator decides.
"""
