import shutil

from cspace.bundle import Bundle, graphs_of
from tests.bundles import write_tiny_bundle
from training.clusters.bundling import with_choices
from training.config import TrainConfig


def test_a_job_that_was_killed_while_it_calibrated_can_be_submitted_again(tmp_path):
    made = Bundle.load(write_tiny_bundle(tmp_path / "made", validity=True))
    draft = tmp_path / "bundle-draft"
    shutil.copytree(made.folder, draft)
    spec = with_choices(draft, TrainConfig.load("smoke").validity, made.spec, graphs_of(made.folder))
    assert spec.confidence_threshold is not None
    assert not draft.exists()
