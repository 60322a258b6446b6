"""The command line of the protocol plans: what it refuses before anything runs."""

import pytest

from cspace.errors import ConfigError, DatasetError
from inference_api.settings import PRETRAINED_FOLDER
from services.evaluator.benchmark import __main__ as command
from services.evaluator.benchmark.job import parser
from services.evaluator.benchmark.plans.job import make_plan_request, refuse_others
from services.evaluator.benchmark.plans.setting import arms_of, plan_units
from tests.space_bundle import write_space_bundle

PLANS = ("--protocol", "plans", "--robot", "panda")


def options(tmp_path, *given):
    return parser().parse_args(["--out", str(tmp_path / "out"), *PLANS, *given])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ((), "no model plans"),
        (("--model", "m@champion"), "behind an API"),
        (("--bundle", "m=x", "--bundle", "m=y"), "share a name"),
        (("--bundle", "unseen is free=x"), "share a name"),
        (("--bundle", "m=x", "--pictures", "5"), "pictures, 5"),
        (("--bundle", "m=x", "--problems", "0"), "problems"),
        (("--bundle", "m=x", "--runs", "0"), "runs"),
        (("--bundle", "m=x", "--time-limit", "0"), "time limit"),
        (("--bundle", "m=x", "--family", "narrow"), "no such family"),
        (("--bundle", "m=x", "--robot", "two-link"), "seen in part"),
        (("--bundle", "m=x", "--robot", "ur5", "--family", "motionbench_cage"), "no such family"),
        (("--bundle", f"m={PRETRAINED_FOLDER}"), "does not plan for this robot"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path, given, words):
    with pytest.raises(ConfigError, match=words):
        make_plan_request(options(tmp_path, *given))


def test_test_problems_need_their_folder(tmp_path):
    with pytest.raises(DatasetError, match="do not ship"):
        make_plan_request(options(tmp_path, "--bundle", "m=x", "--split", "test"))


def test_options_of_another_protocol_are_refused(tmp_path, capsys):
    with pytest.raises(ConfigError, match="no such options") as refused:
        refuse_others(options(tmp_path, "--samples", "10"), parser())
    assert "--samples" in str(refused.value)
    given = ["--out", str(tmp_path), "--pictures", "1", "--no-mlflow"]
    assert command.main(given, {}) == 2
    assert "--pictures" in capsys.readouterr().err


def test_a_request_holds_what_a_set_has_at_most(tmp_path):
    bundle = write_space_bundle(tmp_path / "bundle")
    given = ("--bundle", f"m={bundle}", "--family", "motionbench_cage", "--family", "shelf")
    request = make_plan_request(options(tmp_path, *given))
    assert request.problems == {"motionbench_cage": 30, "shelf": 30}
    assert (request.pictures, request.runs) == ((1, 2, 3), 3)
    assert make_plan_request(options(tmp_path, *given, "--problems", "40")).problems["motionbench_cage"] == 30


def test_only_what_is_missing_is_done():
    arms = arms_of(["m"])
    work = list(plan_units({"shelf": 2}, (1,), 2, arms, set(), None))
    assert [(unit.index, unit.pictures) for unit in work] == [(0, 0), (0, 1), (1, 0), (1, 1)]
    keys = {
        ("shelf", one.index, one.pictures, run, arm.name)
        for one in work
        for arm, runs in one.runs
        for run in runs
    }
    # Six arms without checks; three with them, twice each.
    assert len(keys) == 2 * (6 + 3 * 2)
    assert list(plan_units({"shelf": 2}, (1,), 2, arms, keys, None)) == []
    lacking = keys - {("shelf", 1, 1, 1, "RRT-Connect, ways of m")}
    ((arm, runs),) = next(plan_units({"shelf": 2}, (1,), 2, arms, lacking, None)).runs
    assert (arm.name, runs) == ("RRT-Connect, ways of m", (1,))
