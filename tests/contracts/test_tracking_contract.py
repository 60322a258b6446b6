import json
import math
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from cspace.errors import RegistryError
from cspace.png import encode_png
from services.registry.ports import RunLog, Tracking
from tests.contracts.conftest import Backend
from tests.contracts.mlflow_warnings import MLFLOW_WARNINGS

pytestmark = MLFLOW_WARNINGS

EXPERIMENT = "contract"
DIGEST = "0123456789abcdef" * 4


@pytest.fixture
def run(tracking: Tracking) -> RunLog:
    return tracking.start(EXPERIMENT, "global")


class Pen:
    """Something that draws itself, without matplotlib."""

    def savefig(self, fname: Path, *, format: str) -> None:  # noqa: A002
        assert format == "png"
        fname.write_bytes(encode_png(np.zeros((4, 4, 3), np.uint8)))


def test_a_new_run_has_its_name_its_tags_and_is_running(backend: Backend) -> None:
    run = backend.tracking.start(EXPERIMENT, "vae", tags={"preset": "quickstart"})
    record = backend.read(run.run_id)
    assert (record.name, record.status, record.parent_run_id) == ("vae", "RUNNING", None)
    assert record.tags["preset"] == "quickstart"


def test_a_child_names_its_parent(backend: Backend) -> None:
    parent = backend.tracking.start(EXPERIMENT, "cluster-train")
    child = backend.tracking.start(EXPERIMENT, "local-0", parent_run_id=parent.run_id)
    assert backend.read(child.run_id).parent_run_id == parent.run_id


def test_a_run_of_a_key_is_started_once_and_gone_on_with(backend: Backend) -> None:
    first = backend.tracking.start(EXPERIMENT, "vae", tags={"preset": "smoke"}, key="job/one/vae")
    first.metrics({"kl": 1.0}, 3)
    first.finish()
    again = backend.tracking.start(EXPERIMENT, "vae", key="job/one/vae")
    assert again.run_id == first.run_id
    assert backend.read(again.run_id).status == "RUNNING"
    other = backend.tracking.start(EXPERIMENT, "vae", key="job/two/vae")
    assert other.run_id != first.run_id


def test_a_key_holds_within_its_experiment(backend: Backend) -> None:
    first = backend.tracking.start(EXPERIMENT, "vae", key="job/three/vae")
    other = backend.tracking.start("contract-elsewhere", "vae", key="job/three/vae")
    assert other.run_id != first.run_id


def test_nested_parameters_become_dotted_names(backend: Backend, run: RunLog) -> None:
    run.params({"critic": {"steps": 5, "betas": (0.0, 0.9)}, "seed": 7})
    assert backend.read(run.run_id).params == {
        "critic.steps": "5",
        "critic.betas": "[0.0, 0.9]",
        "seed": "7",
    }


def test_more_parameters_than_one_call_takes_all_arrive(backend: Backend, run: RunLog) -> None:
    run.params({f"p{index}": index for index in range(250)})
    assert len(backend.read(run.run_id).params) == 250


def test_an_overlong_parameter_is_cut_and_the_rest_arrive(backend: Backend, run: RunLog) -> None:
    run.params({"long": "x" * 10_000, "short": 1})
    params = backend.read(run.run_id).params
    assert len(params["long"]) == 6000
    assert params["long"].endswith("...")
    assert params["short"] == "1"


def test_the_same_parameters_may_be_logged_again(backend: Backend, run: RunLog) -> None:
    run.params({"seed": 7})
    run.params({"seed": 7})
    assert backend.read(run.run_id).params == {"seed": "7"}


def test_a_parameter_can_not_change(run: RunLog) -> None:
    run.params({"seed": 7})
    with pytest.raises(RegistryError):
        run.params({"seed": 8})


def test_metrics_are_all_there_when_the_run_is_finished(backend: Backend, run: RunLog) -> None:
    for step in range(1200):
        run.metrics({"critic_loss": 1.0 / (step + 1), "generator_loss": -step}, step)
    run.finish()
    record = backend.read(run.run_id)
    assert record.status == "FINISHED"
    assert record.history["critic_loss"] == [(step, 1.0 / (step + 1)) for step in range(1200)]
    assert [step for step, _ in record.history["generator_loss"]] == list(range(1200))


def test_a_metric_that_is_not_a_number_is_kept_as_such(backend: Backend, run: RunLog) -> None:
    run.metrics({"critic_loss": math.nan}, 3)
    run.flush()
    [(step, value)] = backend.read(run.run_id).history["critic_loss"]
    assert step == 3
    assert math.isnan(value)


def test_a_tag_takes_its_last_value(backend: Backend, run: RunLog) -> None:
    run.tags({"git_dirty": "true", "preset": "paper"})
    run.tags({"git_dirty": "false"})
    tags = backend.read(run.run_id).tags
    assert (tags["git_dirty"], tags["preset"]) == ("false", "paper")


def test_files_and_folders_are_kept_under_their_names(backend: Backend, run: RunLog, tmp_path: Path) -> None:
    folder = tmp_path / "report"
    (folder / "deep").mkdir(parents=True)
    (folder / "a.md").write_text("a")
    (folder / "deep" / "b.md").write_text("b")
    run.artifact(folder / "a.md")
    run.artifact(folder, "report")
    assert backend.read(run.run_id).artifacts == {"a.md", "report/a.md", "report/deep/b.md"}


def test_an_artifact_that_is_not_there_is_refused(run: RunLog, tmp_path: Path) -> None:
    with pytest.raises(RegistryError, match="no such artifact"):
        run.artifact(tmp_path / "nothing")


def test_a_figure_becomes_a_png_among_the_figures(backend: Backend, run: RunLog) -> None:
    run.figure(Pen(), "loss")
    run.figure(Pen(), "seen.png")
    kept = backend.read(run.run_id).artifacts
    assert {name for name in kept if name.startswith("figures/")} == {"figures/loss.png", "figures/seen.png"}


def test_a_table_is_kept_once_for_people_and_for_programs(backend: Backend, run: RunLog) -> None:
    for _ in range(2):
        run.table({"measure": ["precision", "edr"], "value": [0.9, 0.1], "n": [60, None]}, "quality")
    assert backend.read(run.run_id).artifacts == {"tables/quality.json", "tables/quality.parquet"}


def test_a_run_s_name_tells_the_begin_of_its_id(backend: Backend) -> None:
    run = backend.tracking.start("names", "quickstart, seed 0, {id}", key="job/names")
    name = f"quickstart, seed 0, {run.run_id[:6]}"
    assert backend.read(run.run_id).name == name
    again = backend.tracking.start("names", "quickstart, seed 0, {id}", key="job/names")
    assert (again.run_id, backend.read(again.run_id).name) == (run.run_id, name)


def test_a_data_set_is_an_input_with_its_whole_digest(backend: Backend, run: RunLog) -> None:
    run.dataset("own", DIGEST, "data/own", "training")
    assert backend.read(run.run_id).inputs == [("own", DIGEST, "data/own", "training")]


def test_runs_that_name_a_data_set_at_once_all_have_it(backend: Backend) -> None:
    runs = [backend.tracking.start(EXPERIMENT, f"point-{index}") for index in range(6)]
    for round_ in range(3):
        with ThreadPoolExecutor(len(runs)) as pool:
            list(
                pool.map(
                    lambda run, name=f"set-{round_}": run.dataset(name, DIGEST, "data", "training"), runs
                )
            )
    for run in runs:
        assert len(backend.read(run.run_id).inputs) == 3


def test_leaving_the_block_finishes_the_run(backend: Backend, run: RunLog) -> None:
    with run:
        run.metrics({"kl": 1.0}, 0)
    record = backend.read(run.run_id)
    assert record.status == "FINISHED"
    assert record.history == {"kl": [(0, 1.0)]}


def test_an_exception_fails_the_run_and_goes_on(backend: Backend, run: RunLog) -> None:
    run.metrics({"kl": 1.0}, 0)
    with pytest.raises(ZeroDivisionError), run:
        raise ZeroDivisionError
    record = backend.read(run.run_id)
    assert record.status == "FAILED"
    assert record.history == {"kl": [(0, 1.0)]}


def test_an_interrupt_kills_the_run(backend: Backend, run: RunLog) -> None:
    with pytest.raises(KeyboardInterrupt), run:
        raise KeyboardInterrupt
    assert backend.read(run.run_id).status == "KILLED"


def test_a_resumed_run_is_the_same_run_and_runs_again(backend: Backend, run: RunLog) -> None:
    run.metrics({"kl": 1.0}, 0)
    run.finish("FAILED")
    again = backend.tracking.resume(run.run_id)
    assert again.run_id == run.run_id
    assert backend.read(run.run_id).status == "RUNNING"
    again.metrics({"kl": 0.5}, 1)
    again.finish()
    assert backend.read(run.run_id).history == {"kl": [(0, 1.0), (1, 0.5)]}


def test_repeated_steps_of_a_resumed_run_are_not_logged_twice(backend: Backend, run: RunLog) -> None:
    for step in range(6):
        run.metrics({"kl": step, "late": step} if step > 3 else {"kl": step}, step)
    run.flush()
    again = backend.tracking.resume(run.run_id)
    for step in range(3, 8):
        again.metrics({"kl": step, "new": step}, step)
    again.finish()
    history = backend.read(run.run_id).history
    assert [step for step, _ in history["kl"]] == list(range(8))
    assert [step for step, _ in history["new"]] == [3, 4, 5, 6, 7]


def test_an_unknown_run_can_not_be_resumed(tracking: Tracking) -> None:
    with pytest.raises(RegistryError):
        tracking.resume("f" * 32)


def test_a_run_that_has_ended_is_written_onto_and_stays_ended(backend: Backend, run: RunLog) -> None:
    run.finish()
    backend.tracking.note(run.run_id, {"model_version": "m/1"})
    found = backend.tracking.run(run.run_id)
    assert found.tags["model_version"] == "m/1"
    assert backend.read(run.run_id).status == "FINISHED"
    with pytest.raises(RegistryError):
        backend.tracking.note("0" * 32, {"a": "b"})


def test_runs_under_another_are_found_newest_first_with_what_they_keep(
    backend: Backend, tmp_path: Path
) -> None:
    parent = backend.tracking.start(EXPERIMENT, "cluster-train")
    made = []
    for name in ("first", "second"):
        with backend.tracking.start(EXPERIMENT, name, parent_run_id=parent.run_id) as child:
            child.table({"measure": ["edr"], "value": [1.0]}, "measures")
            made.append(child.run_id)
        # MLflow counts in milliseconds.
        time.sleep(0.005)
    found = backend.tracking.children(parent.run_id)
    assert [(one.run_id, one.parent_run_id) for one in found] == [
        (run_id, parent.run_id) for run_id in reversed(made)
    ]
    kept = backend.tracking.file(made[0], "tables/measures.json", tmp_path)
    assert kept is not None
    assert json.loads(kept.read_text()) == {"columns": ["measure", "value"], "data": [["edr", 1.0]]}
    assert backend.tracking.file(made[0], "tables/other.json", tmp_path) is None
    with pytest.raises(RegistryError):
        backend.tracking.run("0" * 32)
