"""The protocol plans: its command line, and a small real benchmark."""

import pandas as pd
import pytest

from cspace.errors import ConfigError, DatasetError
from cspace.simulator import UnseenPolicy
from inference_api.settings import PRETRAINED_FOLDER
from services.evaluator.benchmark.__main__ import make_request, parser
from services.evaluator.benchmark.job import RUNS, run_benchmark
from tests.fakes.benchmark import run_here
from tests.fakes.registry import FakeTracking
from tests.space_bundle import write_space_bundle

PLANS = ("--protocol", "plans", "--robot", "panda")
SMALL = (*PLANS, "--family", "motionbench_table_pick", "--problems", "2", "--pictures", "1")


def options(tmp_path, *given):
    return parser().parse_args(["--out", str(tmp_path / "out"), *PLANS, *given])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ((), "no model plans"),
        (("--bundle", "unseen is free=x"), "share a name"),
        (("--bundle", "m=x", "--family", "narrow"), "no such family"),
        (("--bundle", "m=x", "--robot", "two-link"), "seen in part"),
        (("--bundle", "m=x", "--robot", "ur5", "--family", "motionbench_cage"), "no such family"),
        (("--bundle", f"m={PRETRAINED_FOLDER}"), "does not plan for this robot"),
    ],
)
def test_a_wrong_request_is_refused(tmp_path, given, words):
    with pytest.raises(ConfigError, match=words):
        make_request(options(tmp_path, *given))


def test_test_problems_need_their_folder(tmp_path):
    with pytest.raises(DatasetError, match="do not ship"):
        make_request(options(tmp_path, "--bundle", "m=x", "--split", "test"))


@pytest.mark.slow
def test_a_request_holds_what_a_set_has_at_most(tmp_path):
    given = ("--bundle", f"m={write_space_bundle(tmp_path / 'bundle')}")
    families = ("--family", "motionbench_cage", "--family", "shelf")
    request = make_request(options(tmp_path, *given, *families, "--problems", "40"))
    assert (request.problems, request.pictures) == ({"motionbench_cage": 30, "shelf": 40}, (1, 2, 3))


@pytest.mark.slow
def test_a_benchmark_of_plans_leaves_its_files_and_goes_on_where_it_was_stopped(tmp_path, monkeypatch):
    bundle, out, lines = write_space_bundle(tmp_path / "bundle"), tmp_path / "out", []
    request = make_request(options(tmp_path, "--bundle", f"tiny={bundle}", *SMALL))
    tracking = FakeTracking()

    def stopped(*args):
        yield next(run_here(*args))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_benchmark(request, stopped, lines.append)
    kept = (out / RUNS).read_text()
    run_benchmark(request, run_here, lines.append, tracking)
    assert (out / RUNS).read_text().startswith(kept)
    assert any("3 units to do" in line for line in lines)
    assert (out / "figures/safety.png").stat().st_size > 10_000
    frame = pd.read_parquet(out / "runs.parquet").set_index(["variant", "problem"])
    assert len(frame) == 2 * 6
    known = frame.loc[UnseenPolicy.KNOWN.value]
    assert known["solved"].all()
    assert (known["clearance_m"] > -0.005).all()
    assert not frame.loc[UnseenPolicy.OCCUPIED.value]["solved"].any()
    (run,) = tracking.runs.values()
    assert "MotionBenchMaker_1/tiny/solved" in run.history
    assert "## Plans without exact checks: MotionBenchMaker, 1" in (out / "report.md").read_text()
