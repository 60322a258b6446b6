import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cspace.bundle import Bundle, write_bundle
from cspace.bundle.files import scene
from cspace.bundle.sampling import ProposalCounts
from cspace.errors import InputError
from cspace.query import SampleQuery
from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK, PlanarArm
from tests.bundles import picture, tiny_graphs, tiny_spec, write_tiny_bundle


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Bundle:
    return Bundle.load(write_tiny_bundle(tmp_path_factory.mktemp("plain") / "bundle", samples_per_latent=4))


@pytest.fixture(scope="module")
def scored(tiny_bundle: Path) -> Bundle:
    return Bundle.load(tiny_bundle)


@pytest.fixture(scope="module")
def path_model(tmp_path_factory: pytest.TempPathFactory) -> Bundle:
    return Bundle.load(write_tiny_bundle(tmp_path_factory.mktemp("path") / "bundle", kind="path"))


@pytest.mark.parametrize(("robot", "per_latent"), [(TWO_LINK, 4), (THREE_LINK, 1)], ids=["two", "three"])
def test_a_bundle_gives_as_many_samples_as_asked_for(
    tmp_path: Path, robot: PlanarArm, per_latent: int
) -> None:
    bundle = Bundle.load(write_tiny_bundle(tmp_path / "bundle", robot, samples_per_latent=per_latent))
    for n in (1, 3, 300, 4097, 20_000):
        answer = bundle.sample(picture(), n, 0)
        assert answer.samples.shape == (n, robot.dim)
        assert answer.samples.dtype == np.float32
        assert answer.confidence is None
        assert answer.shortfall == 0


def test_the_same_arguments_give_bit_equal_samples(bundle: Bundle) -> None:
    first, second = (bundle.sample(picture(), 1001, 7, epsilon_sigma=(0.0, 0.5)).samples for _ in range(2))
    assert first.tobytes() == second.tobytes()


def test_a_seed_means_the_same_in_another_process_which_leaves_nothing_in_the_users_folders(
    bundle: Bundle, tmp_path: Path
) -> None:
    code = (
        "import sys; from pathlib import Path; import cspace.bundle; from cspace.bundle.files import scene;"
        "assert 'onnxruntime' not in sys.modules; bundle = cspace.bundle.Bundle.load(Path(sys.argv[1]));"
        "sys.stdout.buffer.write(bundle.sample(scene((48, 48, 3)), 333, 12).samples.tobytes())"
    )
    environment = {"HOME": str(tmp_path), "PYTHONPATH": str(Path(__file__).parents[2])}
    environment["PYTHONDONTWRITEBYTECODE"] = "1"
    command = [sys.executable, "-c", code, str(bundle.folder)]
    done = subprocess.run(command, cwd=tmp_path, env=environment, check=True, capture_output=True)
    assert done.stdout == bundle.sample(scene((48, 48, 3)), 333, 12).samples.tobytes()
    assert list(tmp_path.iterdir()) == []


def test_a_validity_head_scores_every_sample_in_order(scored: Bundle) -> None:
    answer = scored.sample(picture(), 500, 3)
    assert answer.confidence is not None
    brightest = picture().max() / 127.5 - 1.0
    expected = 1 / (1 + np.exp(np.abs(answer.samples).mean(axis=1) - brightest))
    np.testing.assert_allclose(answer.confidence, expected, atol=1e-6)


def test_samples_that_reach_the_confidence_are_as_many_as_asked_for(scored: Bundle) -> None:
    whole = scored.sample(picture(), 500, 3, min_confidence=0.0)
    part = scored.sample(picture(), 500, 3, min_confidence=0.4)
    assert whole.confidence is not None
    assert part.confidence is not None
    share = (whole.confidence >= np.float32(0.4)).mean()
    assert 0.3 < share < 0.9
    assert (len(part.samples), part.shortfall) == (500, 0)
    assert part.confidence.min() >= np.float32(0.4)
    assert part.acceptance == pytest.approx(share, abs=0.1)
    np.testing.assert_array_equal(part.confidence, scored.predict(picture(), part.samples)[0])
    again = scored.sample(picture(), 500, 3, min_confidence=0.4)
    assert part.samples.tobytes() == again.samples.tobytes()


def test_a_filtered_request_keeps_the_shares_of_its_schedule(scored: Bundle) -> None:
    calm = scored.sample(picture(), 100, 3, epsilon_sigma=(0.0,), min_confidence=0.4).samples
    both = scored.sample(picture(), 200, 3, epsilon_sigma=(0.0, 10.0), min_confidence=0.4).samples
    assert len(both) == 200
    # Samples of the raised share spread; those before it do not.
    assert np.abs(both[:100]).mean() == pytest.approx(np.abs(calm).mean(), abs=0.2)
    assert not np.array_equal(both[:100], both[100:])


def test_without_a_confidence_the_bundles_own_threshold_holds(tmp_path: Path) -> None:
    spec = replace(tiny_spec(), confidence_threshold=0.4)
    own = Bundle.load(write_bundle(tmp_path / "own", spec, tiny_graphs(spec, validity=True)))
    default, explicit = own.sample(picture(), 300, 3), own.sample(picture(), 300, 3, min_confidence=0.4)
    everything = own.sample(picture(), 300, 3, min_confidence=0.0)
    assert default.samples.tobytes() == explicit.samples.tobytes() != everything.samples.tobytes()
    assert everything.confidence is not None
    assert everything.confidence.min() < np.float32(0.4)
    assert everything.acceptance == 1.0


def test_a_filtered_request_is_served_by_the_generator_with_a_quarter_of_uniform_proposals(
    tmp_path: Path,
) -> None:
    spec = replace(tiny_spec(), confidence_threshold=0.4)
    bundle = Bundle.load(write_bundle(tmp_path / "bundle", spec, tiny_graphs(spec, validity=True)))
    query = SampleQuery(400, 3, (0.0, 0.5))
    found = bundle.answer(picture(), query)
    counts = found.proposals
    assert counts is not None
    assert counts.generator_kept + counts.uniform_kept == len(found.samples) == 400
    assert 0.2 < counts.uniform / (counts.uniform + counts.generator) < 0.3
    assert 0 < counts.uniform_kept <= counts.uniform
    assert 0 < counts.generator_kept <= counts.generator
    np.testing.assert_array_equal(found.confidence, bundle.predict(picture(), found.samples)[0])
    assert bundle.answer(picture(), query).samples.tobytes() == found.samples.tobytes()
    # Whatever the seed: of a single sample all proposals may be of one kind.
    assert all(bundle.answer(picture(), SampleQuery(1, seed)).shortfall == 0 for seed in range(30))
    unfiltered = bundle.answer(picture(), replace(query, min_confidence=0.0)).proposals
    assert unfiltered == ProposalCounts(generator=400, generator_kept=400)


def test_a_confidence_that_none_reaches_gives_an_empty_answer(scored: Bundle) -> None:
    answer = scored.sample(picture(), 20, 3, min_confidence=1.0)
    assert answer.samples.shape == (0, 2)
    assert (answer.shortfall, answer.acceptance) == (20, 0.0)


def test_a_prepared_picture_gives_the_same_answer_and_the_encoder_rests(scored: Bundle) -> None:
    prepared = scored.prepare(picture())
    for n in (1, 300):
        plain, quick = scored.sample(picture(), n, 4), scored.sample(prepared, n, 4)
        assert plain.samples.tobytes() == quick.samples.tobytes()
        assert plain.encode_ms > 0.0 == quick.encode_ms
    np.testing.assert_array_equal(
        scored.predict(prepared, plain.samples)[0], scored.predict(picture(), plain.samples)[0]
    )


def test_path_models_depend_on_start_and_goal_up_to_whole_turns(path_model: Bundle) -> None:
    def ask(start: Any, goal: Any) -> bytes:
        return path_model.sample(picture(), 30, 3, start=start, goal=goal).samples.tobytes()

    here = ask([0.5, 1.0], [-1.0, 2.0])
    assert here != ask([-1.0, 2.0], [0.5, 1.0])
    assert here == ask(np.array([0.5 + 2 * np.pi, 1.0]), (-1.0, 2.0 - 4 * np.pi))


WRONG: list[dict[str, Any]] = [
    {"n": 0}, {"seed": 2**64}, {"min_confidence": 0.1}, {"start": [0, 0]}, {"goal": [0, 0]},
    {"image": np.zeros((32, 32, 3), np.uint8)}, {"image": np.zeros((48, 48, 3))}, {"image": None},
]  # fmt: skip


@pytest.mark.parametrize("change", WRONG, ids=lambda change: str(change)[:40])
def test_a_wrong_argument_is_an_input_error(bundle: Bundle, change: dict[str, Any]) -> None:
    arguments = {"image": picture(), "n": 3, "seed": 0, **change}
    with pytest.raises(InputError, match="expected"):
        bundle.sample(**arguments)


@pytest.mark.parametrize(
    ("start", "goal"),
    [
        (None, None), ([0, 0], None), (None, [0, 0]), ([0, 0, 0], [0, 0]), ([0, math.nan], [0, 0]),
    ],
)  # fmt: skip
def test_path_models_refuse_endpoints_that_do_not_fit(path_model: Bundle, start: Any, goal: Any) -> None:
    with pytest.raises(InputError):
        path_model.sample(picture(), 3, 0, start=start, goal=goal)
