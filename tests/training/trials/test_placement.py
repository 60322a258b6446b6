"""What travels to trials on a cluster of several nodes."""

import time
from pathlib import Path

import numpy as np
import pytest

from tests.training.trials.ray_nodes import ray_nodes
from training.config import ResourceConfig
from training.trials.launch import TrialRequest, run_trials

# Far above what Ray hands over inline, far below a node's store.
ROWS = 1_000_000


def looker():
    """A trainable that learns nothing: it writes down where it is, and how it got the array."""

    def look(trial, array, notes):
        import ray

        # Without a wait a single node could be through with all before the others have a worker.
        time.sleep(2.0)
        notes_of = (
            ray.get_runtime_context().get_node_id(),
            array.flags.owndata,
            array.flags.writeable,
            array.sum(),
        )
        Path(notes, trial.name).write_text(" ".join(map(str, notes_of)))
        (trial.folder / "last.ckpt").touch()

    return look


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_arrays_are_stored_once_and_reach_each_node_once_however_many_trials_read_them(tmp_path, monkeypatch):
    import ray
    from ray.experimental import get_object_locations

    stored = []
    put = ray.put

    def counted(value, *args, **kwargs):
        reference = put(value, *args, **kwargs)
        if isinstance(value, np.ndarray):
            stored.append(reference)
        return reference

    notes = tmp_path / "notes"
    notes.mkdir()
    trials = [TrialRequest(tmp_path / "job" / "stage" / f"trial-{index}") for index in range(6)]
    with ray_nodes([{"num_cpus": 1}] * 3) as ids:
        monkeypatch.setattr(ray, "put", counted)
        done = run_trials(looker(), trials, {"array": np.ones(ROWS), "notes": str(notes)}, ResourceConfig())
        (reference,) = stored
        where = get_object_locations([reference])[reference]
    assert [outcome.name for outcome in done] == [trial.name for trial in trials]
    lines = [(notes / trial.name).read_text().split() for trial in trials]
    assert {node for node, *_ in lines} == set(ids)
    assert where["object_size"] >= 8 * ROWS
    # A store holds an object once; it is where trials ran, and no trial has a copy of its own.
    assert sorted(where["node_ids"]) == sorted(ids)
    assert {tuple(rest) for _, *rest in lines} == {("False", "False", str(float(ROWS)))}
