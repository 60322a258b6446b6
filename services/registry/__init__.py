"""MLflow: tracking, registered models, signatures, promotion."""
