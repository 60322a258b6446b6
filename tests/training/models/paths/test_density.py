"""The density of paths on a grid: targets, symmetries of the U-Net, and samples in the order of the path."""

import numpy as np
import pytest
import torch

from cspace.worlds.planar.arm import TWO_LINK, PlanarArm
from tests.training.models.path_builders import arrays, generator
from training.models.checkpoint import seeded_initialisation
from training.models.paths.density import DensityModule, DensitySampler, path_targets
from training.models.paths.settings import DensityConfig
from training.models.paths.unet import CellGrid, CellMaps, PathUNet, WrappedConv

CELLS = 16
TINY = DensityConfig(
    ways=False, cells=CELLS, width=8, steps=200, batch_size=16, jitter_rad=0.0, learning_rate=1e-2
)


@pytest.fixture(scope="module")
def grid():
    return CellGrid(TWO_LINK.space, CELLS)


@pytest.fixture(scope="module")
def trained():
    given = arrays(cells=CELLS)
    with seeded_initialisation(0):
        module = DensityModule(TINY, given.samples(), torch.tensor(given.maps), None, TWO_LINK.space, 0)
    losses = []
    for step in range(TINY.steps):
        module.training_step(step, 0)
        losses.append(module.metrics()["density_loss"])
    return module.eval(), losses


def test_targets_are_the_paths_share_of_each_cell_with_mean_place_and_offset(grid):
    size = 2.0 * np.pi / CELLS
    middle = grid.centres[3 * CELLS + 5]
    away = torch.tensor([0.25 * size, 0.0])
    path = torch.stack([middle, middle + away, middle + torch.tensor([size, 0.0])]).unsqueeze(0)
    targets = path_targets(path, grid)
    assert targets.shares.sum().item() == pytest.approx(1.0)
    assert targets.shares[0, 3 * CELLS + 5].item() == pytest.approx(2.0 / 3.0)
    assert targets.places[0, 3 * CELLS + 5].item() == pytest.approx(0.25)
    assert targets.offsets[0, 3 * CELLS + 5].tolist() == pytest.approx([0.125, 0.0], abs=1e-5)
    assert targets.shares[0, 4 * CELLS + 5].item() == pytest.approx(1.0 / 3.0)


def test_a_mark_is_seen_across_the_seam(grid):
    marks = grid.marks(torch.tensor([[np.pi - 1e-3, 0.0]], dtype=torch.float32))[0]
    row = CELLS // 2
    assert marks[-1, row] > 0.5
    assert marks[0, row] == pytest.approx(marks[-1, row].item(), abs=0.01)
    assert marks[CELLS // 2, row] < 1e-3


def test_a_wrapped_convolution_moves_with_its_map_and_one_with_limits_does_not():
    with seeded_initialisation(1):
        wrapped, limited = WrappedConv(1, 1, (True, True)), WrappedConv(1, 1, (True, False))
    limited.load_state_dict(wrapped.state_dict())
    values = torch.randn(1, 1, 8, 8, generator=generator())
    torch.testing.assert_close(wrapped(values.roll((2, 3), (2, 3))), wrapped(values).roll((2, 3), (2, 3)))
    torch.testing.assert_close(limited(values.roll(2, 2)), limited(values).roll(2, 2))
    assert not torch.allclose(limited(values.roll(3, 3)), limited(values).roll(3, 3))


def test_a_turned_path_stays_on_its_turned_map():
    given = arrays(cells=CELLS)
    module = DensityModule(TINY, given.samples(), torch.tensor(given.maps), None, TWO_LINK.space, 3)
    grid = module.net.grid
    path = torch.tensor([[[0.1, 0.3], [0.9, -1.2], [2.9, 3.0]]])
    confidence = torch.zeros(1, CELLS**2)
    confidence[0, grid.cell(path[0])] = 1.0
    for _ in range(20):
        turned_map, turned = module._turned(confidence.view(1, 1, CELLS, CELLS), path)
        assert turned_map.flatten()[grid.cell(turned[0])].tolist() == [1.0, 1.0, 1.0]


def test_training_finds_the_straight_way_through_an_empty_space(trained):
    module, losses = trained
    # As unsure as can be is log 256 = 5.5 nat.
    assert np.mean(losses[-20:]) < 4.0 < np.mean(losses[:5])
    start, goal = torch.tensor([[-1.0, -1.0]]), torch.tensor([[1.0, 1.0]])
    sampler = DensitySampler(module.net, TINY, sweep=1)
    count = 200
    place = torch.linspace(0.0, 0.999, count).unsqueeze(1)
    ends = [end.expand(count, 2) for end in (start, goal)]
    with torch.no_grad():
        found = sampler(torch.ones(CELLS**2), place, torch.zeros(count, 2), *ends)[:, 0]
    # The way is the diagonal; half a cell is 0.2 rad.
    assert (found[:, 0] - found[:, 1]).abs().median() < 0.3
    assert found[:20].mean() < -0.4
    assert found[-20:].mean() > 0.4


def test_samples_are_drawn_by_the_density_in_the_order_of_progress(grid):
    class Known(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.grid = grid

        def forward(self, *_):
            density = torch.full((1, CELLS**2), -1e9)
            density[0, 7], density[0, 3] = np.log(0.75), np.log(0.25)
            progress = torch.zeros(1, CELLS**2)
            progress[0, 7], progress[0, 3] = 1.0, 2.0
            return CellMaps(density, progress, torch.zeros(1, CELLS**2, 2))

    sampler = DensitySampler(Known(), TINY, sweep=1)
    place = torch.tensor([[0.0], [0.7], [0.8], [0.999]])
    ends = torch.zeros(4, 2)
    found = sampler(torch.ones(CELLS**2), place, torch.zeros(4, 2), ends, ends)[:, 0]
    torch.testing.assert_close(found, grid.centres[[7, 7, 3, 3]])


def test_a_robot_with_limits_is_not_turned():
    limited = PlanarArm(joint_limits_rad=((-3.0, 3.0), None))
    given = arrays(cells=CELLS)
    module = DensityModule(TINY, given.samples(), torch.tensor(given.maps), None, limited.space, 0)
    module.training_step(0, 0)
    assert np.isfinite(module.metrics()["density_loss"])
    assert isinstance(module.net, PathUNet)
