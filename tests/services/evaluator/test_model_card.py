"""Model cards, printed from the registry."""

import pytest

from cspace.bundle import Bundle
from cspace.errors import ModelNotFoundError
from inference_api.settings import PRETRAINED_FOLDER
from services.evaluator.job import evaluate_version
from services.evaluator.model_card import make_card
from services.names import ALIAS_CHALLENGER, MODEL_NAME, TAG_PRESET
from services.registry.entities import ModelReference
from services.registry.promotion import promote
from tests.bundles import write_tiny_bundle
from tests.fakes.registry import FakeRegistry, FakeTracking
from tests.services.evaluator.test_job import request

PANDA_FOLDER = PRETRAINED_FOLDER.with_name("pretrained_panda")


class Platform:
    """A registry whose first version is a bundle, and what tracks it."""

    def __init__(self, folder, bundle):
        self.tracking = FakeTracking()
        self.registry = FakeRegistry(folder / "registry", self.tracking.runs)
        run = self.tracking.start(MODEL_NAME, "cluster-train")
        self.version = self.registry.register(
            MODEL_NAME,
            bundle.folder,
            run.run_id,
            bundle.digest,
            {TAG_PRESET: "quick"},
            alias=ALIAS_CHALLENGER,
        )

    def card(self, model=MODEL_NAME + "/1"):
        return make_card(ModelReference.parse(model), self.registry, self.tracking)


@pytest.fixture
def tiny(tmp_path, verified_here):
    return Platform(tmp_path, Bundle.load(write_tiny_bundle(tmp_path / "bundle")))


def test_a_card_has_figures_with_intervals_decisions_and_lineage(tiny):
    outcome = evaluate_version(request(), tiny.tracking, tiny.registry, progress=lambda line: None)
    promote(tiny.registry, tiny.registry.version(MODEL_NAME, 1), "seen on the arm")
    card = tiny.card(f"{MODEL_NAME}@champion")
    assert card.startswith(f"# {MODEL_NAME}/1, challenger, champion\n")
    table = {
        cells[1].strip(): cells[2].strip() for line in card.splitlines() if len(cells := line.split("|")) == 4
    }
    assert table["robot"].startswith("two-link, 2 joints, digest ")
    assert table["pictures"].startswith("48 x 48 RGB of the plane")
    assert (table["preset"], table["run"], table["licence"]) == ("quick", tiny.version.run_id, "Apache-2.0")
    assert table["bundle"] == f"SHA-256 {tiny.version.digest}"
    precision = outcome.evaluation.estimate("precision", "sampler", "uniform")
    limits = f"[{precision.low:.3f}, {precision.high:.3f}]"
    assert table["precision, validation, uniform, all samples"] == f"{precision.estimate:.3f} {limits}, n 2"
    assert "precision, test, uniform, all samples" in table
    assert f"Evaluation {outcome.run_id}" in card
    decisions = card.partition("## Decisions")[2]
    assert decisions.index("not promoted") < decisions.index("by hand: seen on the arm")


def test_a_version_that_nobody_evaluated_says_so(tiny):
    card = tiny.card()
    assert "## Figures\n\nNot evaluated yet." in card
    assert card.endswith("## Decisions\n\nNone yet.\n")
    with pytest.raises(ModelNotFoundError):
        tiny.card(f"{MODEL_NAME}/2")


def test_the_card_of_an_arm_in_space_names_its_cameras_and_what_plans_promise(tmp_path, verified_here):
    card = Platform(tmp_path, Bundle.load(PANDA_FOLDER)).card()
    assert "| depth pictures; count 1-3, " in card
    assert "below 0.2 a plan is refused" in card
    assert "| command | `" in card
