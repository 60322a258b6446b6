"""One MLflow store for the tests of the adapters."""

from pathlib import Path

import pytest

from services.registry.tracking import Tracking


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a database, mlflow.db, which takes seconds to make."""
    folder = tmp_path_factory.mktemp("database")
    with pytest.MonkeyPatch.context() as patch:
        # The store fixes its folder of artifacts, ./mlruns, when it is opened for the first time.
        patch.chdir(folder)
        Tracking(f"sqlite:///{folder / 'mlflow.db'}").start("first", "first")
    return folder
