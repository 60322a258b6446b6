from pathlib import Path

from lightning.pytorch.callbacks import ModelCheckpoint

from tests.training.models.builders import run, save, tiny_joint_module, tiny_module
from training.models.checkpoint import AtomicCheckpoints, fit_module, load_weights


def test_a_checkpoint_holds_the_weights_of_each_part_and_replaces_the_one_before(tmp_path: Path) -> None:
    module = tiny_module()
    path = save(tmp_path / "one.ckpt", module)
    assert set(load_weights(path, "critic")) == set(module.critic.state_dict())
    AtomicCheckpoints().save_checkpoint({"state_dict": {"critic.a": module.critic.state_dict()}}, path)
    assert list(load_weights(path, "critic")) == ["a"]
    assert list(tmp_path.iterdir()) == [path]


def test_a_resumed_training_ends_bit_for_bit_where_the_uninterrupted_one_does(tmp_path: Path) -> None:
    whole = run(tiny_joint_module(), 8)
    keep = ModelCheckpoint(tmp_path, "last", every_n_train_steps=4, enable_version_counter=False)
    fit_module(tiny_joint_module(), 4, callbacks=[keep])
    resumed = run(tiny_joint_module(seed=5), 8, tmp_path / "last.ckpt")
    assert "images" not in resumed.state_dict()
    for name, value in whole.state_dict().items():
        assert value.equal(resumed.state_dict()[name]), name
