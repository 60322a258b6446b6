from tests.training.models.builders import tiny_module
from training.models.checkpoint import Progress, load_weights, read_progress, save_checkpoint


def test_a_checkpoint_replaces_the_one_before_and_holds_no_pickle(tmp_path):
    module = tiny_module()
    module.training_step(0, 0)
    progress = Progress(2, "abc", ({"step": 2.0, "critic_loss": 1.0},))
    for one in (Progress(1, "abc", ()), progress):
        folder = save_checkpoint(tmp_path / "checkpoint", module, one)
    assert read_progress(folder) == progress
    assert list(tmp_path.iterdir()) == [folder]
    assert sorted(path.suffix for path in folder.iterdir()) == [".json", ".safetensors", ".safetensors"]
    assert set(load_weights(folder, "critic")) == set(module.critic.state_dict())
