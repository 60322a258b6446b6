import os

import pytest

from training.sweeps.grid import axis, points
from training.sweeps.progress import stage_of
from training.sweeps.record import PointResult
from training.sweeps.tables import Standing, final_table, progress_lines, seconds_left

GRID = points([axis("clusters.count=[1, 2]"), axis("seed=[0, 1]")])


def finished(seconds, edr, precision=0.5):
    return PointResult("finished", seconds, {"precision": precision, "coverage": 0.9, "edr": edr}, "run-x")


def test_time_left_is_that_of_the_slowest_or_of_all_hands_together():
    running = [
        Standing(point, "running", elapsed_s=spent) for point, spent in zip(GRID, (10, 70), strict=False)
    ]
    waiting = [Standing(point, "waiting") for point in GRID[2:]]
    # The median of 80, 100 and 120; 90 and 30 remain of those that run, and two whole ones.
    assert seconds_left(running + waiting, [80, 120, 100], 2) == (90 + 30 + 200) / 2
    assert seconds_left(running, [80, 120, 100], 2) == 90
    assert seconds_left(running, [], 2) is None
    assert seconds_left([Standing(GRID[0], "running", elapsed_s=500)], [100], 2) == 0


def test_progress_tells_of_the_whole_and_of_each_point_that_runs_or_failed():
    results = {GRID[0]: finished(100, 0.1), GRID[1]: PointResult("failed", 5, {}, error="no room")}
    standings = [
        Standing(GRID[0], "finished"),
        Standing(GRID[1], "failed"),
        Standing(GRID[2], "running", "local, step 250, 1", 40.0),
        Standing(GRID[3], "waiting"),
    ]
    assert progress_lines(standings, results, 2) == [
        "sweep: 1 finished, 1 running, 1 waiting, 1 failed of 4, about 2 min left",
        "  clusters.count=1, seed=1 | failed | no room",
        "  clusters.count=2, seed=0 | running | local, step 250, 1, about 60 s left",
    ]


def test_before_a_point_has_finished_nobody_knows_the_time():
    lines = progress_lines([Standing(GRID[0], "running")], {}, 1)
    assert lines == [
        "sweep: 1 running of 1",
        "  clusters.count=1, seed=0 | running | starting",
    ]


@pytest.mark.parametrize(("sort", "seeds"), [("edr", "10"), ("precision", "01"), ("seconds", "01")])
def test_the_final_table_goes_from_best_to_worst_and_failed_points_come_last(sort, seeds):
    results = {
        GRID[2]: PointResult("failed", 1, {}, error="no room"),
        GRID[0]: finished(10, 0.3, precision=0.9),
        GRID[1]: finished(20, 0.2, precision=0.8),
    }
    header, *rows = final_table(results, sort)
    assert header == ["clusters.count", "seed", "precision", "coverage", "edr", "seconds", "run"]
    assert "".join(row[1] for row in rows) == seeds + "0"
    assert rows[-1][2:] == ["-", "-", "-", "1", "failed"]


def test_the_stage_is_the_one_that_began_last_with_the_step_of_each_trials_checkpoint(tmp_path):
    def began(stage, trial, age_s, *steps):
        folder = tmp_path / stage / trial
        folder.mkdir(parents=True)
        (folder / "lock").touch()
        os.utime(folder / "lock", (1000 - age_s, 1000 - age_s))
        for step in steps:
            (folder / f"step-{step:09d}").mkdir()

    (tmp_path / "spool").mkdir()
    assert stage_of(tmp_path) == ""
    began("pictures", "vae", 50, 250, 400)
    assert stage_of(tmp_path) == "pictures, step 400"
    began("local", "local-0", 10)
    began("local", "local-1", 5, 250)
    assert stage_of(tmp_path) == "local, step 0, 250"
