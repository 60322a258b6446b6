"""The field of space: its views, its network, and a job that goes on after a stop."""

from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from cspace.bundle.runtime import Graph
from training import field
from training.field import FieldScenes, varied
from training.models.field import FieldNet, field_graph, new_field
from training.scene_model import named_arm, scene_world


@pytest.fixture(scope="module")
def net() -> FieldNet:
    return new_field(varied(scene_world(named_arm("panda"))), load_file(field.SCENE_MODEL))


def test_a_number_is_one_view_wherever_a_job_begins() -> None:
    world = varied(scene_world(named_arm("panda")))
    views = iter(FieldScenes(world, 0, 3))
    next(views)
    second, again = next(views), next(iter(FieldScenes(world, 1, 3)))
    for one, other in zip(second, again, strict=True):
        np.testing.assert_array_equal(one, other)
    array, occupied, _ = second
    assert array.shape == (*occupied.shape, 2)
    # Half a voxel about what is occupied, a surface that was seen is near.
    assert 0.0 < occupied.mean() < 0.3


def test_what_a_voxel_says_is_read_at_its_own_place(net: FieldNet) -> None:
    array = torch.zeros(1, 2, 16, 16, 16)
    array[0, 1, 5, 8, 11] = 1.0
    cells = net._raw(array).reshape(6, 2, 2, 2, 8, 8, 8)
    # Out of view is the fourth of six states.
    assert cells[3].nonzero().tolist() == [[1, 0, 1, 2, 4, 5]]


def test_the_graph_says_what_the_network_says(net: FieldNet) -> None:
    image = np.random.default_rng(0).random((1, 2, 16, 16, 32), dtype=np.float32)
    low_m = (-0.2, -0.2, 0.0)
    graph = Graph("field.onnx", field_graph(net, (16, 16, 32), low_m), {"image"}, {"occupancy"})
    found = graph.run({"image": image}, {"occupancy": (16, 16, 32)})["occupancy"]
    with torch.no_grad():
        own = torch.sigmoid(net(torch.from_numpy(image), torch.tensor(low_m)))[0].numpy()
    np.testing.assert_allclose(found, own, atol=1e-4)


@pytest.mark.slow
def test_a_stopped_job_goes_on_with_the_next_views(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(field, "SAVE_EVERY", 1)
    begun = []
    real = FieldScenes.__init__

    def note(self: FieldScenes, world: object, first: int, seed: int) -> None:
        begun.append(first)
        real(self, world, first, seed)  # type: ignore[arg-type]

    monkeypatch.setattr(FieldScenes, "__init__", note)
    for steps in ("2", "3"):
        assert field.main([str(tmp_path), "--steps", steps]) == 0
    assert begun == [0, 4]
    assert torch.load(tmp_path / "last.ckpt", weights_only=True)["global_step"] == 3
