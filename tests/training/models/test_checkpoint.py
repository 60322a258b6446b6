import torch

from tests.training.models.builders import tiny_module
from training.models.checkpoint import Progress, load_checkpoint, load_weights, read_progress, save_checkpoint


def run(module, first, last):
    for step in range(first, last):
        module.training_step(step, step)
    return module


def test_a_resumed_training_ends_bit_for_bit_where_the_uninterrupted_one_does(tmp_path):
    whole = run(tiny_module(), 0, 10)
    half = run(tiny_module(), 0, 5)
    folder = save_checkpoint(tmp_path / "checkpoint", half, Progress(5, "run", ()))
    resumed = tiny_module(seed=0)
    load_checkpoint(folder, resumed)
    run(resumed, 5, 10)
    for name, value in whole.state_dict().items():
        assert torch.equal(value, resumed.state_dict()[name]), name


def test_a_checkpoint_remembers_its_step_run_and_history(tmp_path):
    progress = Progress(7, "abc", ({"step": 5.0, "critic_loss": 1.0},))
    folder = save_checkpoint(tmp_path / "checkpoint", tiny_module(), progress)
    assert read_progress(folder) == progress


def test_saving_again_replaces_the_checkpoint_and_leaves_nothing_beside(tmp_path):
    for step in (1, 2):
        save_checkpoint(tmp_path / "checkpoint", tiny_module(), Progress(step, "run", ()))
    assert read_progress(tmp_path / "checkpoint").step == 2
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint"]


def test_a_checkpoint_holds_no_pickle(tmp_path):
    folder = save_checkpoint(tmp_path / "checkpoint", run(tiny_module(), 0, 1), Progress(1, "run", ()))
    assert sorted(path.suffix for path in folder.iterdir()) == [".json", ".safetensors", ".safetensors"]


def test_the_weights_of_one_part_are_found_by_its_name(tmp_path):
    module = tiny_module()
    folder = save_checkpoint(tmp_path / "checkpoint", module, Progress(0, "run", ()))
    assert set(load_weights(folder, "critic")) == set(module.critic.state_dict())
