"""Warnings that MLflow raises about itself and its own dependencies, each by its own words."""

import pytest

MLFLOW_WARNINGS = [
    # Its tables, with SQLAlchemy 2.1.
    pytest.mark.filterwarnings("ignore:The ``noload`` loader strategy:DeprecationWarning"),
    # Its own response types, when mlflow.pyfunc is imported.
    pytest.mark.filterwarnings("ignore:.*Any type hint is inferred as AnyType:UserWarning"),
    # Its reading of an input example, with pandas 3.
    pytest.mark.filterwarnings("ignore:Operation with range is deprecated:DeprecationWarning"),
]
