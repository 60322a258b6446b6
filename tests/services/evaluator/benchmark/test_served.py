"""The benchmark against a real inference API, and over a real Ray cluster."""

import json
from pathlib import Path

import pandas as pd
import pytest

from cspace.errors import SamplerError, SamplerUnavailableError
from cspace.files import encode_png
from cspace.worlds import default_world
from cspace.worlds.planar.camera import decode_png
from services.evaluator.benchmark import __main__ as command
from services.evaluator.benchmark.sources import fresh_picture, served
from tests.bundles import picture, write_tiny_bundle
from tests.inference_api.server import api_server

ROOT = Path(__file__).resolve().parents[4]
NUMBERS = ("problem", "variant", "solved", "iterations", "edge_checks", "length_rad")
NAMES = ("RRT, way, 70 %", "RRT, way, 100 %")


def test_a_fresh_picture_is_another_file_with_the_same_pixels():
    file = encode_png(picture())
    first, second = (fresh_picture(file, note) for note in ("1", "2"))
    assert len({file, first, second}) == 3
    assert (decode_png(first, 48) == decode_png(file, 48)).all()


@pytest.mark.e2e
@pytest.mark.slow
def test_a_model_behind_the_api_is_measured_with_what_its_server_reports(tmp_path, path_folder):
    out = tmp_path / "out"
    with api_server(tmp_path, {"CSPACE_PRETRAINED_MODEL": str(path_folder)}) as url:
        given = [
            "--out", str(out), "--api", url, "--model", "way=pretrained", "--family", "uniform",
            "--problems", "3", "--processes", "1", "--no-mlflow", "--variants", *NAMES,
        ]  # fmt: skip
        assert command.main(given, {}) == 0
    sampler = json.loads((out / "manifest.json").read_text())["samplers"]["way"]
    assert (sampler["model"], sampler["transport"], sampler["with_ends"]) == ("pretrained", "HTTP", True)
    frame = pd.read_parquet(out / "runs.parquet")
    learned = frame[frame["sampler"] == "way"]
    assert len(learned) == 3 * len(NAMES)
    assert ((learned["server_s"] > 0.0) & (learned["server_s"] < learned["request_s"])).all()
    assert learned["solved"].all()


@pytest.mark.e2e
def test_a_model_of_configurations_is_found_out_by_its_answers(tmp_path):
    bundle = write_tiny_bundle(tmp_path / "bundle")
    with api_server(tmp_path, {"CSPACE_PRETRAINED_MODEL": str(bundle)}) as url:
        spec = served("tiny", "pretrained", url, default_world())
        assert (spec.with_ends, spec.model, spec.url) == (False, "pretrained", url)
        with pytest.raises(SamplerError):
            served("tiny", "no-such-model@champion", url, default_world())
    with pytest.raises(SamplerUnavailableError):
        served("tiny", "pretrained", url, default_world())
