import pytest

from cspace.errors import ConfigError
from training.sweeps.grid import axis, points
from training.sweeps.record import PointResult, SweepRecord

SMALL, GROWN = (points([axis(f"seed={seeds}")]) for seeds in ("[0, 1]", "[0, 1, 2]"))


def test_a_sweep_that_goes_on_knows_its_run_and_how_its_points_ended_even_in_a_grid_that_has_grown(tmp_path):
    began = SweepRecord.create(tmp_path, "seeds", "smoke", ["vae.steps=2"], "run-1")
    began.keep(SMALL[0], PointResult("finished", 3.0, {"edr": 0.5}, "run-2"))
    began.keep(SMALL[1], PointResult("failed", 1.0, {}, error="no room"))
    again = SweepRecord.load(tmp_path, "seeds", "smoke", ["vae.steps=2"])
    assert again == began
    assert [again.result(point) for point in GROWN] == [
        PointResult("finished", 3.0, {"edr": 0.5}, "run-2"),
        PointResult("failed", 1.0, {}, error="no room"),
        None,
    ]


def test_a_points_job_is_named_after_the_sweep_and_its_settings(tmp_path):
    record = SweepRecord.create(tmp_path, "seeds", "smoke", [], "run-1")
    names = [record.job_id(point) for point in GROWN]
    assert len(set(names)) == 3
    assert all(name.startswith("seeds-") and len(name) <= 63 for name in names)


def test_a_name_that_is_new_has_no_sweep(tmp_path):
    assert SweepRecord.load(tmp_path, "seeds", "smoke", []) is None


@pytest.mark.parametrize(("preset", "overrides"), [("quickstart", []), ("smoke", ["seed=1"])])
def test_a_name_stands_for_one_preset_and_its_settings(tmp_path, preset, overrides):
    SweepRecord.create(tmp_path, "seeds", "smoke", [], "run-1")
    with pytest.raises(ConfigError, match="a name of its own"):
        SweepRecord.load(tmp_path, "seeds", preset, overrides)


@pytest.mark.parametrize("name", ["", "Seeds", "a/b", "../x", "a" * 49, "-a"])
def test_a_name_that_could_not_be_a_folder_or_a_job_is_refused(tmp_path, name):
    with pytest.raises(ConfigError, match="a-z, 0-9"):
        SweepRecord.load(tmp_path, name, "smoke", [])
