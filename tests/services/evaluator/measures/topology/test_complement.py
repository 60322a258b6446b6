import numpy as np
import pytest

from cspace.errors import EvaluationError
from cspace.space import JointSpace
from services.evaluator.measures.topology import (
    boundary_cells,
    complement_score,
    enlarged_turns,
    geometry_score,
    largest_score,
    mean_living_times,
    occupancy,
    quarter_turn,
    sample_complement,
    square_to_disk,
    turned_living_times,
)

TORUS = JointSpace((-np.pi, -np.pi), (np.pi, np.pi), (True, True))
LIMITED = JointSpace((-1.0, -2.0), (1.0, 2.0), (False, False))
CUBE = JointSpace((-1.0,) * 3, (1.0,) * 3, (False,) * 3)


def square_with_hole(count, rng, half=1.0):
    points = TORUS.sample_uniform(rng, 4 * count)
    return points[np.abs(points).max(axis=1) > half][:count]


def test_the_grid_holds_about_four_uniform_points_a_cell(rng):
    counts = occupancy(TORUS.sample_uniform(rng, 1000), TORUS)
    assert counts.shape == (15, 15)
    assert counts.sum() == 1000
    assert 4.0 <= counts.mean() < 5.0


def test_a_lone_empty_cell_is_chance_and_a_pair_is_boundary():
    counts = np.ones((5, 5), dtype=np.int64)
    counts[1, 1] = counts[3, 3] = counts[3, 2] = 0
    expected = np.zeros((5, 5), dtype=bool)
    expected[3, 2:4] = True
    np.testing.assert_array_equal(boundary_cells(counts, (False, False)), expected)


@pytest.mark.parametrize(("periodic", "found"), [((True, True), 2), ((False, True), 0)])
def test_neighbours_close_round_a_circle_only(periodic, found):
    counts = np.ones((4, 4), dtype=np.int64)
    counts[0, 2] = counts[3, 2] = 0
    assert boundary_cells(counts, periodic).sum() == found


def test_the_complement_fills_the_hole_and_nothing_else(rng):
    complement = sample_complement(square_with_hole(2000, rng), TORUS, rng, 3000)
    assert complement.shape == (3000, 2)
    assert np.mean(np.abs(complement).max(axis=1) < 1.0) > 0.97
    # Evenly weighted by area: each quarter of the hole gets its share.
    assert np.mean(complement[:, 0] > 0) == pytest.approx(0.5, abs=0.05)


def test_regions_are_weighted_by_their_area(rng):
    points = TORUS.sample_uniform(rng, 60_000)
    wide = (np.abs(points[:, 0] + 1.5) < 0.8) & (np.abs(points[:, 1]) < 1.6)
    small = (np.abs(points[:, 0] - 1.5) < 0.8) & (np.abs(points[:, 1]) < 0.4)
    complement = sample_complement(points[~wide & ~small], TORUS, rng, 20_000)
    assert np.mean(complement[:, 0] < 0) == pytest.approx(0.8, abs=0.03)


def test_a_cloud_without_gaps_has_an_empty_complement(rng):
    axis = np.linspace(-3.1, 3.1, 80)
    full = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    assert sample_complement(full, TORUS, rng, 50).shape == (0, 2)


def test_the_complement_stays_inside_joint_limits_beyond_a_turn(rng):
    wide = JointSpace((-7.0, -4.0), (7.0, 1.0), (False, False))
    points = wide.sample_uniform(rng, 2000)
    complement = sample_complement(points[points[:, 0] < 0], wide, rng, 500)
    assert wide.contains(complement).all()
    assert np.mean(complement[:, 0] > 0.0) > 0.95


def test_the_square_maps_onto_the_disk():
    square = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [0.5, 0.5]])
    disk = square_to_disk(square)
    half = np.sqrt(0.5)
    expected = [[0, 0], [1, 0], [0, -1], [half, half], [-half, half], [0.5 * np.sqrt(0.875)] * 2]
    np.testing.assert_allclose(disk, expected)


def test_four_quarter_turns_come_back_and_one_is_counter_clockwise():
    points = np.array([[1.0, 0.25]])
    np.testing.assert_array_equal(quarter_turn(points, 1), [[-0.25, 1.0]])
    np.testing.assert_array_equal(quarter_turn(points, 4), points)


def test_each_turn_enlarges_another_quadrant_by_the_exponential():
    corner = np.array([[np.pi, np.pi]])
    half = np.sqrt(0.5)
    largest = [disk.max() for disk in enlarged_turns(corner, TORUS)]
    np.testing.assert_allclose(largest, [np.exp(half), np.exp(half), np.exp(-half), np.exp(half)])


def test_the_disk_map_refuses_three_joints(rng):
    with pytest.raises(EvaluationError, match="two joints"):
        next(enlarged_turns(CUBE.sample_uniform(rng, 5), CUBE))


def turned(points, seed, space=TORUS):
    return turned_living_times(points, space, np.random.default_rng(seed), draws=12)


def test_the_complement_tells_a_hole_from_uniform_samples(rng):
    real, again = (square_with_hole(1000, rng, half=1.5) for _ in range(2))
    uniform = TORUS.sample_uniform(rng, 1000)
    clouds = [turned(p, 1) for p in (real, again, uniform)]
    complements = [turned(sample_complement(p, TORUS, rng, 1000), 2) for p in (real, again, uniform)]
    same = complement_score(clouds[0], clouds[1], complements[0], complements[1])
    other = complement_score(clouds[0], clouds[2], complements[0], complements[2])
    assert same < other


def test_the_score_is_the_sum_of_both_maxima_over_twice_the_number_of_bins(rng):
    first, second = turned(square_with_hole(200, rng), 1), turned(TORUS.sample_uniform(rng, 200), 2)
    expected = (largest_score(first, second) + largest_score(second, first)) / 198
    assert complement_score(first, second, second, first) == pytest.approx(expected)
    assert complement_score(first, first, second, second) == 0.0


def scored(first, second, space, seed):
    """GS-C of two clouds with the complements from the points."""
    rng = np.random.default_rng(seed)
    complements = [turned(sample_complement(p, space, rng, 1000), seed + 1, space) for p in (first, second)]
    return complement_score(turned(first, seed + 2, space), turned(second, seed + 3, space), *complements)


def block(count, rng, centre, space, half=0.5):
    """Points in a square or cube."""
    return np.asarray(centre) + rng.uniform(-half, half, (count, space.dim))


def test_a_shifted_set_is_equal_to_gs_and_not_to_gsc_inside_the_joint_limits():
    # In the middle of the limits the complement goes round the block, in the corner it does not.
    rng = np.random.default_rng(7)
    middle = block(1000, rng, (0.0, 0.0), LIMITED)
    shifted = middle + np.array([0.5, 1.5])
    plain = [mean_living_times(p, np.random.default_rng(1), draws=5) for p in (middle, shifted)]
    assert geometry_score(*plain) == pytest.approx(0.0, abs=1e-6)
    away = [scored(middle, shifted, LIMITED, seed) for seed in range(3)]
    again = [scored(middle, block(1000, rng, (0.0, 0.0), LIMITED), LIMITED, seed) for seed in range(3)]
    assert min(away) > max(again)


def test_three_joints_are_scored_without_turns():
    # A bore from limit to limit gives the cube a loop, and a complement where the full cube has none.
    rng = np.random.default_rng(8)
    full, again, other = (CUBE.sample_uniform(rng, 2000) for _ in range(3))
    bored = other[np.abs(other[:, :2]).max(axis=1) > 0.5]
    assert len(turned(bored, 1, CUBE)) == 1
    changed = [scored(full, bored, CUBE, seed) for seed in range(2)]
    same = [scored(full, again, CUBE, seed) for seed in range(2)]
    assert min(changed) > max(same)


def test_clouds_of_two_and_of_three_joints_cannot_be_compared(rng):
    planar, spatial = turned(square_with_hole(200, rng), 1), turned(CUBE.sample_uniform(rng, 200), 1, CUBE)
    with pytest.raises(EvaluationError, match="turns"):
        largest_score(planar, spatial)


def test_an_empty_cloud_has_no_loop_and_a_small_one_is_an_error():
    empty = turned(np.empty((0, 2)), 1)
    assert [times.values[0] for times in empty] == [1.0] * 4
    with pytest.raises(EvaluationError, match="too small"):
        turned(np.zeros((10, 2)), 1)
