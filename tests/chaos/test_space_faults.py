"""The same faults while a sampler of an arm in space is trained: other data, other trials."""

import time
from collections.abc import Iterator

import pytest

from tests.chaos.checks import Left
from tests.chaos.system import Kind, System, settings
from tests.chaos.test_faults import same, survive, whole

pytestmark = [pytest.mark.e2e, pytest.mark.slow, pytest.mark.timeout(900, func_only=True)]

SMALL = (
    *("data.scenario_count=6", "data.proposals_per_scenario=80", "data.shard_size=2"),
    *("vae.latent_dim=8", "vae.width=4", "vae.batch_size=4"),
    *(
        "validity.scene_model=null",
        "validity.pictures_per_step=2",
        "validity.configurations_per_picture=8",
        "validity.hidden=8",
    ),
    *(
        "validity.grid={width: 4, middle: 4, deep: 4}",
        "validity.threshold=0.05",
        "validity.plan_problems=7",
    ),
    *("gate.cells=4", "gate.points=64", "local.hidden=16", "local.critic_hidden=16", "local.batch_size=32"),
)
STEPS = {"vae": 50, "validity": 100, "gate": 150, "local-0": 300, "local-1": 300}


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    kind = Kind("panda_quick", "panda-sampler", SMALL)
    with System(tmp_path_factory.mktemp("system"), tmp_path_factory.mktemp("data"), kind) as system:
        yield system


@pytest.fixture(scope="module")
def undisturbed(system: System) -> tuple[Left, float]:
    """What a job leaves that nothing happens to, and how long it takes when its data are there."""
    driver = system.submit("first", settings(STEPS))
    assert driver.wait() == 0, driver.printed
    began = time.monotonic()
    driver = system.submit("undisturbed", settings(STEPS))
    assert driver.wait() == 0, driver.printed
    return whole(system, driver, STEPS), time.monotonic() - began


@pytest.mark.parametrize("fault", ["kill_worker", "kill_driver", "kill_server"])
def test_a_fault_loses_nothing_and_changes_no_weight(
    fault: str, system: System, undisturbed: tuple[Left, float]
) -> None:
    expected, taken_s = undisturbed
    left, _ = survive(system, (fault,), 1, taken_s, STEPS)
    assert same(left, expected)


def test_a_driver_that_is_killed_while_data_are_made_goes_on_from_its_shards(
    system: System, undisturbed: tuple[Left, float]
) -> None:
    expected, _ = undisturbed
    other = (*settings(STEPS), "data.seed=1", "data.scenario_count=12")
    driver = system.submit("data", other)
    for _ in driver.moments():
        if list((system.data / "datasets").glob("*.partial/scenes-*.npz")):
            driver.process.kill()
    assert driver.wait() != 0
    kept = list((system.data / "datasets").glob("*.partial/scenes-*.npz"))
    assert 0 < len(kept) < 6
    again = system.submit("data", other)
    assert again.wait() == 0, again.printed
    assert not same(whole(system, again, STEPS), expected)
