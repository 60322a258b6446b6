import json
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from cspace.errors import RegistryError
from cspace.files import encode_png
from services.names import TAG_PARENT
from services.registry.tracking import RunLog, Tracking
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


def test_a_run_of_a_key_is_started_once_within_its_experiment_and_gone_on_with(backend: Backend) -> None:
    first = backend.tracking.start(EXPERIMENT, "vae, {id}", tags={"preset": "smoke"}, key="job/one/vae")
    first.metrics({"kl": 1.0}, 3)
    first.finish()
    again = backend.tracking.start(EXPERIMENT, "vae, {id}", key="job/one/vae")
    assert again.run_id == first.run_id
    record = backend.read(again.run_id)
    # A run's name may tell how its id begins.
    assert (record.status, record.name) == ("RUNNING", f"vae, {first.run_id[:6]}")
    for experiment, key in ((EXPERIMENT, "job/two/vae"), ("contract-elsewhere", "job/one/vae")):
        assert backend.tracking.start(experiment, "vae", key=key).run_id != first.run_id


def test_parameters_become_dotted_names_and_may_be_logged_again_but_not_change(
    backend: Backend, run: RunLog
) -> None:
    for _ in range(2):
        run.params({"critic": {"steps": 5, "betas": (0.0, 0.9)}, "seed": 7})
    expected = {"critic.steps": "5", "critic.betas": "[0.0, 0.9]", "seed": "7"}
    assert backend.read(run.run_id).params == expected
    with pytest.raises(RegistryError):
        run.params({"seed": 8})


def test_more_parameters_than_one_call_takes_all_arrive_and_overlong_ones_are_cut(
    backend: Backend, run: RunLog
) -> None:
    run.params({f"p{index}": index for index in range(150)} | {"long": "x" * 10_000})
    params = backend.read(run.run_id).params
    assert len(params) == 151
    assert len(params["long"]) == 6000
    assert params["long"].endswith("...")


def test_files_and_folders_are_kept_under_their_names(backend: Backend, run: RunLog, tmp_path: Path) -> None:
    folder = tmp_path / "report"
    (folder / "deep").mkdir(parents=True)
    (folder / "a.md").write_text("a")
    (folder / "deep" / "b.md").write_text("b")
    run.artifact(folder / "a.md")
    run.artifact(folder, "report")
    assert backend.read(run.run_id).artifacts == {"a.md", "report/a.md", "report/deep/b.md"}
    with pytest.raises(RegistryError, match="no such artifact"):
        run.artifact(tmp_path / "nothing")


def test_figures_are_pngs_and_a_table_is_kept_once(backend: Backend, run: RunLog) -> None:
    run.figure(Pen(), "loss")
    run.figure(Pen(), "seen.png")
    for _ in range(2):
        run.table({"measure": ["precision", "edr"], "value": [0.9, 0.1], "n": [60, None]}, "quality")
    # MLflow keeps what its page shows in a folder of its own.
    kept = {name for name in backend.read(run.run_id).artifacts if not name.startswith("images/")}
    assert kept == {"figures/loss.png", "figures/seen.png", "tables/quality.json"}


def test_runs_that_name_a_data_set_at_once_all_have_it_with_its_whole_digest(backend: Backend) -> None:
    runs = [backend.tracking.start(EXPERIMENT, f"point-{index}") for index in range(6)]
    names = ["set-0", "set-1", "set-2"]
    with ThreadPoolExecutor(len(runs)) as pool:
        for name in names:
            list(pool.map(lambda run, name=name: run.dataset(name, DIGEST, "data/own", "training"), runs))
    for run in runs:
        inputs = sorted(backend.read(run.run_id).inputs)
        assert inputs == [(name, DIGEST, "data/own", "training") for name in names]


@pytest.mark.parametrize(
    ("error", "status"), [(None, "FINISHED"), (ZeroDivisionError, "FAILED"), (KeyboardInterrupt, "KILLED")]
)
def test_leaving_the_block_ends_the_run_and_an_exception_goes_on(
    backend: Backend, run: RunLog, error: type[BaseException] | None, status: str
) -> None:
    with nullcontext() if error is None else pytest.raises(error), run:
        run.metrics({"kl": 1.0}, 0)
        if error is not None:
            raise error
    record = backend.read(run.run_id)
    assert (record.status, record.history) == (status, {"kl": [(0, 1.0)]})


def test_a_resumed_run_runs_again_and_keeps_a_point_that_is_sent_twice_once(
    backend: Backend, run: RunLog
) -> None:
    rows = [{"step": step, "time_ms": 1000.0 + step, "kl": step / 7} for step in range(6)]
    run.history(rows[:4])
    run.finish("FAILED")
    again = backend.tracking.resume(run.run_id)
    assert (again.run_id, backend.read(run.run_id).status) == (run.run_id, "RUNNING")
    again.history([*rows, *rows])
    again.finish()
    assert backend.read(run.run_id).history["kl"] == [(step, step / 7) for step in range(6)]


def test_a_run_that_has_ended_is_written_onto_and_stays_ended(backend: Backend, run: RunLog) -> None:
    run.finish()
    backend.tracking.note(run.run_id, {"model_version": "m/1"})
    found = backend.tracking.run(run.run_id)
    assert found.data.tags["model_version"] == "m/1"
    assert backend.read(run.run_id).status == "FINISHED"
    with pytest.raises(RegistryError):
        backend.tracking.note("0" * 32, {"a": "b"})
    with pytest.raises(RegistryError):
        backend.tracking.resume("f" * 32)


def test_the_runs_of_an_experiment_that_have_finished_are_found_newest_first(backend: Backend) -> None:
    experiment, made = f"finished-{time.time_ns()}", []
    for name in ("first", "second"):
        with backend.tracking.start(experiment, name) as run:
            made.append(run.run_id)
        # MLflow counts in milliseconds.
        time.sleep(0.005)
    backend.tracking.start(experiment, "running")
    assert [one.info.run_id for one in backend.tracking.finished(experiment)] == made[::-1]
    assert backend.tracking.finished("no such experiment") == []


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
    assert [(one.info.run_id, one.data.tags[TAG_PARENT]) for one in found] == [
        (run_id, parent.run_id) for run_id in reversed(made)
    ]
    kept = backend.tracking.file(made[0], "tables/measures.json", tmp_path)
    assert kept is not None
    assert json.loads(kept.read_text()) == {"columns": ["measure", "value"], "data": [["edr", 1.0]]}
    assert backend.tracking.file(made[0], "tables/other.json", tmp_path) is None
    for _ in range(2):
        backend.tracking.remove_file(made[0], "tables/measures.json")
        assert backend.tracking.file(made[0], "tables/measures.json", tmp_path) is None
    assert backend.tracking.file(made[1], "tables/measures.json", tmp_path) is not None
    with pytest.raises(RegistryError):
        backend.tracking.run("0" * 32)
