"""Whatever is killed, filled or taken away while a job trains: submitted again by name, it loses nothing.

Real processes throughout. Each fault strikes at a moment that is drawn from a seed; then the same command is
given until it succeeds. What is left has to be what an undisturbed job leaves, to the last bit of the weights
(the tally of what was injected and what was lost goes to ``build/chaos.md``).
"""

import os
import random
import subprocess
import time
from collections.abc import Iterator

import pytest

from tests.chaos import faults
from tests.chaos.checks import Left, left_behind
from tests.chaos.system import EVERY, ROOT, Driver, System, settings

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(600)]

STEPS = {"vae": 150, "validity": 150, "local-0": 400, "local-1": 400, "global": 400}
FEW = {"vae": 50, "validity": 50, "local-0": 150, "local-1": 150, "global": 150}
# About what a job of few steps takes; its faults need no better moments.
FEW_TAKE_S = 30.0
TALLY = ROOT / "build" / "chaos.md"
# More attempts than any fault should need.
ATTEMPTS = 4
# Jobs that are struck in turn until one was not over before.
TRIES = 3
LATE = "too late"
REPEATED = [
    (fault, seed)
    for fault in ("kill_worker", "kill_driver", "stop_job", "kill_server", "kill_head")
    for seed in (1, 2)
]


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    with System(tmp_path_factory.mktemp("system"), tmp_path_factory.mktemp("data")) as system:
        yield system


@pytest.fixture(scope="module")
def undisturbed(system: System) -> tuple[Left, float]:
    """What a job leaves that nothing happens to, and how long it takes."""
    began = time.monotonic()
    driver = system.submit("undisturbed", settings(STEPS))
    assert driver.wait() == 0, driver.printed
    taken_s = time.monotonic() - began
    return whole(system, driver, STEPS), taken_s


def survive(
    system: System, kinds: tuple[str, ...], seed: int, taken_s: float, steps: dict[str, int]
) -> tuple[Left, list[Driver]]:
    """Strike a job, submit it until it succeeds, and look at what it left; returns that, and all attempts.

    Each fault has its share of the time that an undisturbed job takes, and strikes at a moment within it. A
    job that was over before, as the machine had less to do, shows nothing: another one is struck sooner.
    """
    for sooner in range(TRIES):
        name = f"{'-'.join(kinds).replace('_', '-')}-{seed}" + (f"-{sooner}" if sooner else "")
        rng = random.Random(name)  # noqa: S311 - a moment, not a secret
        attempts, struck = _strike(system, kinds, name, rng, taken_s * 0.6**sooner, steps)
        left = whole(system, attempts[-1], steps)
        _note(f"| {name} | {', '.join(struck)} | {len(attempts)} | 0 |")
        if LATE not in struck:
            return left, attempts
    raise AssertionError(f"{name}: the job was over {TRIES} times before it could be struck")


def whole(system: System, driver: Driver, steps: dict[str, int]) -> Left:
    """What a driver that has ended well left."""
    address, model = system.server.address, system.kind.model
    return left_behind(address, system.data, driver.result, steps, EVERY, model)


def _strike(
    system: System,
    kinds: tuple[str, ...],
    name: str,
    rng: random.Random,
    taken_s: float,
    steps: dict[str, int],
) -> tuple[list[Driver], list[str]]:
    driver = system.submit(name, settings(steps))
    attempts, struck, share_s = [driver], [], 0.75 * taken_s / len(kinds)
    for number, kind in enumerate(kinds):
        moment_s = 0.2 * taken_s + (number + rng.random()) * share_s
        for now_s in driver.moments():
            if now_s >= moment_s:
                break
        hit = getattr(faults, kind)(system, driver, rng)
        struck.append(f"{moment_s:.1f}" if hit else LATE)
    while attempts[-1].wait() != 0:
        assert len(attempts) < ATTEMPTS, attempts[-1].printed
        attempts.append(system.submit(name, settings(steps)))
    return attempts, struck


def same(one: Left, other: Left) -> bool:
    """Whether the weights of all trials and the exported graphs are equal to the last bit."""
    return one.weights == other.weights and one.digests == other.digests


def _note(row: str) -> None:
    """A row of the tally; a fault that loses something fails its test and has none."""
    TALLY.parent.mkdir(exist_ok=True)
    if not TALLY.exists():
        TALLY.write_text("| faults and seed | struck at, s | submissions | lost |\n|---|---:|---:|---:|\n")
    with TALLY.open("a") as file:
        file.write(row + "\n")


def test_a_killed_worker_and_then_a_killed_driver_lose_nothing(system: System) -> None:
    survive(system, ("kill_worker", "kill_driver"), 0, FEW_TAKE_S, FEW)


@pytest.mark.slow
@pytest.mark.parametrize(("fault", "seed"), REPEATED)
def test_repeated_faults_lose_nothing_and_change_no_weight(
    fault: str, seed: int, system: System, undisturbed: tuple[Left, float]
) -> None:
    expected, taken_s = undisturbed
    left, _ = survive(system, (fault,), seed, taken_s, STEPS)
    assert same(left, expected)


@pytest.fixture
def small_disk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    """A system whose data folder is a disk of its own, which can be filled."""
    data = tmp_path_factory.mktemp("disk")
    if os.getuid() != 0:
        pytest.skip("only root can mount a small disk")
    mount = ["mount", "-t", "tmpfs", "-o", "size=400m", "tmpfs", str(data)]
    if subprocess.run(mount, check=False).returncode != 0:
        pytest.skip("no disk can be mounted here")
    try:
        with System(tmp_path_factory.mktemp("system"), data) as system:
            yield system
    finally:
        subprocess.run(["umount", "--lazy", str(data)], check=True)  # noqa: S607


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_full_disk_loses_nothing_and_is_told(small_disk: System) -> None:
    began = time.monotonic()
    driver = small_disk.submit("undisturbed", settings(STEPS))
    assert driver.wait() == 0, driver.printed
    taken_s = time.monotonic() - began
    expected = whole(small_disk, driver, STEPS)
    for seed in range(3):
        left, attempts = survive(small_disk, ("fill_disk",), seed, taken_s, STEPS)
        assert same(left, expected)
        if len(attempts) > 1:
            assert "No space left" in attempts[0].printed or "too full" in attempts[0].printed


@pytest.mark.slow
def test_a_full_disk_is_told_before_the_work(small_disk: System) -> None:
    filler = small_disk.data / "filler"
    faults.fill(filler)
    driver = small_disk.submit("full", settings(FEW))
    assert driver.wait() != 0
    assert "the data folder cannot be written" in driver.printed or "too full" in driver.printed
    assert driver.printed.count("Traceback") == 0
    filler.unlink()
