"""Where the examples of a document run: a folder of their own, with the pictures that the documents name."""

import shutil
from pathlib import Path

import pytest

from tests.docs.blocks import ROOT


@pytest.fixture(scope="module")
def docs_scratch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One folder a document."""
    folder = tmp_path_factory.mktemp("docs")
    shutil.copytree(ROOT / "docs" / "images", folder / "docs" / "images")
    return folder
