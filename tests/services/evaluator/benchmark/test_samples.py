"""Real problems, the real planners, and samples of the shipped head's path sampler."""

from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from cspace.errors import ConfigError, SamplerError
from cspace.png import encode_png
from cspace.query import SampleQuery
from cspace.simulator import Split
from cspace.worlds import default_world, examples
from cspace.worlds.planar.camera import decode_png
from cspace.worlds.planar.problems import Family, draw_problem
from services.evaluator.benchmark.arms import Unit, pick, table
from services.evaluator.benchmark.samples import SampleWorker, filtered_samples, known_problem, state_check_s
from services.evaluator.benchmark.sources import ask, bundled, fresh_picture, opened, parse_named
from services.planner.result import Reason
from services.planner.rrt_connect import order_along
from tests.bundles import picture, write_tiny_bundle

NAMES = ("RRT, way, 70 %", "RRT, way, 100 %", "PRM, way, 100 %", "RRT*, way, 70 %, optimising")
ARMS = pick(table(["way"], 1.0), NAMES)
PLAIN, OPTIMISING = (pick(table(["way"], 1.0), [NAMES[place]]) for place in (0, 3))


@pytest.fixture(scope="module")
def spec(path_folder):
    return bundled("way", path_folder)


@pytest.fixture(scope="module")
def sources(spec):
    with opened([spec], default_world()) as found:
        yield found


def test_a_bundle_that_is_open_leaves_no_files_that_an_ended_worker_could_not_take_away(
    spec, tmp_path, monkeypatch
):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with opened([spec], default_world()) as found:
        assert not list(tmp_path.iterdir())
        batch = ask(found["way"], spec, draw_problem(Family.NARROW, Split.DEMO, 1), SampleQuery(20, 3))
    assert batch.samples.shape == (20, 2)


class Counting:
    """A source that counts what it is asked."""

    def __init__(self, source):
        self.source, self.calls = source, Counter()

    def answer(self, picture, query, model=None):
        self.calls[query.n, query.epsilon_sigma, query.min_confidence] += 1
        return self.source.answer(picture, query, model)


def run(arms, family, setting, spec, sources, index=0):
    worker = SampleWorker(setting, [])
    worker.sources, worker.specs = sources, {"way": spec}
    found = worker.run(Unit(family, index, tuple((arm, 0) for arm in arms)))
    return {one["arm"]: SimpleNamespace(**one) for one in found}


@pytest.fixture(scope="module")
def narrow(setting, spec, sources):
    """A run of every arm on a narrow problem."""
    return run(ARMS, Family.NARROW, setting, spec, sources)


def test_every_arm_solves_the_same_problem_with_the_same_seed(narrow):
    assert set(narrow) == {arm.name for arm in ARMS}
    assert len({one.seed for one in narrow.values()}) == 1
    assert all(one.solved for one in narrow.values())
    for one in narrow.values():
        assert one.total_s == one.request_s + one.solve_s
        assert one.check_s + one.plan_s == pytest.approx(one.solve_s)
        assert one.check_s == one.state_checks * one.state_check_s > 0.0
        learned = one.sampler == "way"
        assert (one.learned_drawn > 0) is learned
        assert (one.samples_got, one.samples_asked) == ((300, 300) if learned else (0, 0))


def test_a_request_is_split_and_one_in_this_process_has_no_transport(narrow):
    one = narrow["RRT, way, 70 %"]
    assert min(one.decode_s, one.encode_s, one.generate_s) > 0.0
    assert one.decode_s + one.encode_s + one.generate_s <= one.server_s
    assert (one.transport_s, one.request_s) == (0.0, one.server_s)
    assert narrow["RRT, uniform"].request_s == 0.0


def test_arms_that_ask_for_the_same_share_a_request(setting, spec, sources):
    counting = Counting(sources["way"])
    wanted = (*NAMES, "RRT, way, schedule", "RRT, way, schedule in order", "RRT, way, 70 %, filtered")
    found = run(pick(table(["way"], 1.0), wanted), Family.UNIFORM, setting, spec, {"way": counting})
    assert sorted(counting.calls.values()) == [1, 1, 1]
    plain = [found[name] for name in NAMES]
    assert len({one.request_s for one in plain}) == 1


def test_an_optimising_run_tells_how_the_length_fell_and_others_end_with_their_first_solution(
    narrow, setting
):
    one = narrow["RRT*, way, 70 %, optimising"]
    assert one.iterations == setting.optimising_iterations
    assert len(one.cost_s) == len(one.cost_iterations) == len(one.cost_edge_checks) >= 2
    assert one.cost_length_rad == sorted(one.cost_length_rad, reverse=True)
    assert (one.first_length_rad, one.first_iterations) == (one.cost_length_rad[0], one.cost_iterations[0])
    assert one.length_rad <= one.first_length_rad + 1e-9
    other = narrow["RRT, uniform"]
    assert (other.first_iterations, other.first_length_rad) == (other.iterations, other.length_rad)
    assert other.cost_s == []


def test_where_there_is_no_path_nothing_succeeds_and_the_limit_ends_it(setting, spec, sources):
    short = replace(setting, max_iterations=200)
    arms = [arm for arm in ARMS if arm.stop_at_first]
    for one in run(arms, Family.DISCONNECTED, short, spec, sources).values():
        assert not one.solved
        assert (one.reason, one.iterations) == (Reason.ITERATION_LIMIT, 200)
        assert one.length_rad is one.first_s is one.first_iterations is None
        assert one.bottleneck_rad == 0.0


def test_a_path_that_the_independent_check_refuses_is_no_success(setting, spec, sources, monkeypatch):
    monkeypatch.setattr(
        "services.evaluator.benchmark.samples.check_path", lambda *given: Reason.REJECTED, raising=True
    )
    for one in run(PLAIN + OPTIMISING, Family.UNIFORM, setting, spec, sources).values():
        assert (one.solved, one.length_rad, one.cost_s) == (False, None, [])
        assert one.reason == Reason.REJECTED


def test_another_model_than_the_one_that_was_named_is_an_error(setting, spec, sources):
    with pytest.raises(SamplerError, match="another model answers for way"):
        run(PLAIN, Family.UNIFORM, setting, replace(spec, digest="0" * 64), sources)


@pytest.fixture
def drawn(setting, sources):
    """40 samples for a problem in the order in which the planner of an arm draws them, and as they came."""
    by_name = {arm.name: arm for arm in table(["way"], 1.0)}
    problem = known_problem(setting.world, Family.UNIFORM, setting.split, 0, 0)
    ends = {"start": problem.start.tolist(), "goal": problem.goal.tolist()}
    white = encode_png(np.full((48, 48, 3), 255, np.uint8))

    def of(name, **how):
        batch = sources["way"].sample(white, 40, seed=3, min_confidence=0.0, **ends, **how)
        return filtered_samples(by_name[name], batch, problem), batch.samples, problem

    return of


def test_perturbed_samples_are_mixed_unless_the_papers_order_is_wanted(drawn):
    sigma = {"epsilon_sigma": (0.0, 1.0)}
    in_order, samples, _ = drawn("RRT, way, schedule in order", **sigma)
    assert np.array_equal(in_order, samples)
    shuffled, _, _ = drawn("RRT, way, schedule", **sigma)
    assert not np.array_equal(shuffled, samples)
    assert np.array_equal(shuffled, drawn("RRT, way, schedule", **sigma)[0])
    assert np.array_equal(np.sort(shuffled, axis=0), np.sort(samples, axis=0))


def test_ordered_samples_are_the_same_ones_along_the_way(drawn):
    ordered, samples, problem = drawn("RRT, way, 70 %, ordered")
    order = order_along(samples, problem.start, problem.goal, problem.scenario.robot.space)
    assert np.array_equal(ordered, samples[order])
    assert not np.array_equal(ordered, samples)


def test_checked_arms_take_all_that_others_take_and_count_what_they_check(setting, tmp_path):
    wanted = [f"RRT, way, 100 %{rest}" for rest in ("", ", colliding last")]
    short = replace(setting, max_iterations=400)
    plain_model = bundled("way", write_tiny_bundle(tmp_path / "bundle"))
    with opened([plain_model], default_world()) as sources:
        found = run(pick(table(["way"], 1.0), wanted), Family.DISCONNECTED, short, plain_model, sources)
    plain, checked = (found[name] for name in wanted)
    assert plain.learned_drawn == checked.learned_drawn == 300
    assert plain.samples_got == checked.samples_got == 300
    assert not plain.solved
    assert checked.group == "checked"
    assert checked.iterations == plain.iterations == 400


def test_a_model_of_configurations_is_asked_without_start_and_goal(setting, tmp_path):
    plain = bundled("way", write_tiny_bundle(tmp_path / "bundle"))
    assert not plain.with_ends
    with opened([plain], default_world()) as found:
        one = run(PLAIN, Family.UNIFORM, setting, plain, found)["RRT, way, 70 %"]
    assert one.samples_got == 300


def test_a_fresh_png_is_another_file_of_the_same_picture(tmp_path):
    png = encode_png(picture())
    first, second = fresh_picture(png, "1"), fresh_picture(png, "2")
    assert len({png, first, second}) == 3
    for data in (first, second):
        assert np.array_equal(decode_png(data), picture())
    path = tmp_path / "note.png"
    path.write_bytes(second)
    with Image.open(path) as opened_picture:
        opened_picture.load()
        assert opened_picture.info["Comment"] == "2"
    with pytest.raises(ValueError, match="IEND"):
        fresh_picture(png[:-1], "1")


def test_a_fresh_view_is_another_file_of_the_same_scene():
    view = examples()["panda"].blank_picture()
    fresh = fresh_picture(view, "1")
    assert fresh != view
    assert np.array_equal(examples()["panda"].read_picture(fresh), examples()["panda"].read_picture(view))


def test_a_look_at_a_state_takes_well_under_the_time_of_a_python_call(setting):
    # No bound on a machine's speed: less than a thousandth of a second, and more than nothing.
    found = state_check_s(known_problem(setting.world, Family.UNIFORM, setting.split, 0, 0), 1.0, 0.0314)
    assert 0.0 < found < 1e-3


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("path-sampler@champion", ("path-sampler", "path-sampler@champion")),
        ("path-sampler/3", ("path-sampler", "path-sampler/3")),
        ("new=build/a=b", ("new", "build/a=b")),
    ],
)
def test_a_sampler_is_named_or_names_itself(text, expected):
    assert parse_named(text) == expected


@pytest.mark.parametrize("text", ["", "=x", "a=", "a,b=x"])
def test_a_sampler_without_a_proper_name_is_refused(text):
    with pytest.raises(ConfigError, match="no proper name"):
        parse_named(text)
