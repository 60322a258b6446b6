"""The paper's comparison on tiny bundles: what it asks of the jobs, and its table and figure."""

import numpy as np
import pytest

from benchmarks import paper
from benchmarks.paper import COLUMNS, encoder_of, measure, overrides, reconstruction, train, typical
from cspace.bundle import Bundle
from cspace.errors import JobError
from cspace.simulator import Split
from cspace.worlds.planar.world import PlanarWorld
from services.evaluator.scenes import Stage
from tests.bundles import write_tiny_bundle
from training.config import TrainConfig


@pytest.fixture
def bundle(tmp_path, monkeypatch):
    monkeypatch.setattr(paper, "TOPOLOGY_SCENES", 1)
    monkeypatch.setattr(paper, "DRAWS", 2)
    return Bundle.load(write_tiny_bundle(tmp_path / "bundle"))


@pytest.mark.parametrize("column", COLUMNS, ids=lambda column: column.name)
def test_every_column_is_a_valid_job_with_the_same_share_and_width_and_encoder(column, tmp_path):
    config = TrainConfig.load(column.preset, overrides(column, 0.1, 16, tmp_path))
    assert config.vae.steps == 600
    sections = config.to_dict()
    gans = {name: sections[name] for name in ("global", "local") if name in sections}
    steps = {"global": 15_630, "local": 7_820}
    assert {name: gan["steps"] for name, gan in gans.items()} == {name: steps[name] for name in gans}
    assert {size for gan in gans.values() for size in (gan["hidden"], gan["critic_hidden"])} == {16}
    assert config.trains_encoder or config.vae.checkpoint == tmp_path


def test_a_finished_column_is_not_trained_again_and_a_failed_one_ends_the_study(tmp_path):
    log = tmp_path / "logs" / "joint.log"
    log.parent.mkdir()
    log.write_text("run: abc\nRESULT {}\n")
    job = tmp_path / "data" / "jobs" / "abc"
    assert train(tmp_path, COLUMNS[1], []) == job
    assert encoder_of(job) == job / "pictures" / "vae" / "final.ckpt"
    with pytest.raises(JobError, match="the column means failed"):
        train(tmp_path, COLUMNS[2], ["no.such=1"])


@pytest.mark.slow
def test_the_table_has_the_column_beside_uniform_and_real_samples_and_the_figure_its_samples(bundle):
    rows = measure("tiny", Split.TEST, 0, bundle, 2)
    assert [row["column"] for row in rows] == ["tiny", "uniform", "real"]
    assert rows[2]["precision"].startswith("1.000")
    assert "(" in rows[0]["GS-C x 1e4 (noise floor)"]
    stage = Stage(PlanarWorld(), Split.DEMO, 0)
    scene = typical(stage, among=3)
    figure = reconstruction([scene], {"tiny": bundle})
    clouds = [axes for axes in figure.axes if "free" in axes.get_xlabel()]
    assert [len(axes.collections) for axes in clouds] == [2, 2]
    assert clouds[0].get_xlabel() == "100.0% free"
    assert np.isclose(sum(len(one.get_offsets()) for one in clouds[1].collections), 1000)
