"""Whose encoder and head path models see with, and that fine-tuned ones see with the same."""

import json

import pytest

from cspace.bundle import Bundle
from cspace.errors import ConfigError
from inference_api.settings import PRETRAINED_FOLDER
from training.paths.writing import require_source


def made(start, source_digest):
    """The bundle of a path model, as far as it tells what it saw with."""
    values = json.loads((PRETRAINED_FOLDER / "bundle.json").read_text())
    values["provenance"]["config"]["source_digest"] = source_digest
    folder = start / "bundles" / "wgan"
    folder.mkdir(parents=True)
    (folder / "bundle.json").write_text(json.dumps(values))


def test_path_models_start_from_those_that_saw_with_the_same_source(tmp_path):
    source = Bundle.load(PRETRAINED_FOLDER, check=False)
    require_source(None, source)
    made(tmp_path / "same", source.digest)
    require_source(tmp_path / "same", source)
    made(tmp_path / "other", "f" * 64)
    with pytest.raises(ConfigError, match="source is not that of start_from"):
        require_source(tmp_path / "other", source)
