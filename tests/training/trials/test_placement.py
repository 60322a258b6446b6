"""Where trials run and what travels to them, on clusters of several nodes."""

import time
from pathlib import Path

import numpy as np
import pytest

from tests.training.trials.ray_nodes import ray_nodes
from training.config import ResourceConfig
from training.trials.launch import TrialRequest, run_trials

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

TRIALS = 6
# Far above what Ray hands over inline, far below a node's store.
ROWS = 1_000_000


def looker():
    """A trainable that learns nothing: it writes down where it is, when, and how it got the array."""

    def look(trial, array, notes):
        import ray

        began = time.time()
        # Without a wait a single node could be through with all before the others have a worker.
        time.sleep(2.0)
        note = [
            ray.get_runtime_context().get_node_id(),
            str(array.flags.owndata),
            str(array.flags.writeable),
            str(int(array.sum())),
            *(str(number) for number in ray.get_gpu_ids()),
        ]
        Path(notes, trial.name).write_text("\n".join([f"{began} {time.time()}", *note]))
        (trial.folder / "step-000000001").mkdir(parents=True)
        return {"steps_per_s": 1.0}

    return look


def run(tmp_path, resources, trials=TRIALS, array=None):
    """The notes of the trials, by name: their times, and the rest."""
    notes = tmp_path / "notes"
    notes.mkdir()
    requests = [TrialRequest(tmp_path / "job" / "stage" / f"trial-{index}") for index in range(trials)]
    shared = {"array": np.ones(1) if array is None else array, "notes": str(notes)}
    done = run_trials(looker(), requests, shared, resources)
    assert [outcome.name for outcome in done] == [request.name for request in requests]
    lines = {path.name: path.read_text().splitlines() for path in sorted(notes.iterdir())}
    return {name: (tuple(map(float, times.split())), *rest) for name, (times, *rest) in lines.items()}


def most_at_once(notes):
    times = [note[0] for note in notes.values()]
    return max(sum(start <= moment < end for start, end in times) for moment, _ in times)


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

    with ray_nodes([{"num_cpus": 1}] * 3) as ids:
        monkeypatch.setattr(ray, "put", counted)
        notes = run(tmp_path, ResourceConfig(), array=np.ones(ROWS))
        (reference,) = stored
        where = get_object_locations([reference])[reference]
    assert len(notes) == TRIALS
    assert {note[1] for note in notes.values()} == set(ids)
    assert where["object_size"] >= 8 * ROWS
    # A store holds an object once; it is where trials ran, and no trial has a copy of its own.
    assert sorted(where["node_ids"]) == sorted(ids)
    assert {note[2:5] for note in notes.values()} == {("False", "False", str(ROWS))}


def test_two_trials_share_a_gpu_that_each_needs_half_of(tmp_path):
    with ray_nodes([{"num_cpus": 4, "num_gpus": 1}]):
        notes = run(tmp_path, ResourceConfig(gpus_per_trial=0.5), trials=4)
    assert most_at_once(notes) == 2
    assert {note[5:] for note in notes.values()} == {("0",)}


def test_a_trial_goes_where_there_is_memory_for_it(tmp_path):
    small, large = 400 * 2**20, 1100 * 2**20
    with ray_nodes([{"num_cpus": 4, "memory": small}, {"num_cpus": 4, "memory": large}]) as (_, roomy):
        notes = run(tmp_path, ResourceConfig(memory_mb_per_trial=500.0), trials=4)
    assert {note[1] for note in notes.values()} == {roomy}
    assert most_at_once(notes) == 2
