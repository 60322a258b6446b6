import shutil
from pathlib import Path

import pytest

from tests.bundles import write_tiny_bundle


@pytest.fixture(scope="session")
def tiny_bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a tiny bundle with a validity head, which no test changes."""
    return write_tiny_bundle(tmp_path_factory.mktemp("tiny") / "bundle", validity=True)


@pytest.fixture
def folder(tiny_bundle: Path, tmp_path: Path) -> Path:
    """The same bundle in a folder of the test's own."""
    return Path(shutil.copytree(tiny_bundle, tmp_path / "bundle"))
