import math

import pytest
import torch

from cspace.space import circles
from tests.training.models.builders import tiny_module
from training.models import autoencoders
from training.models.families import wgan_gp
from training.models.joints import Joints


def test_the_losses_of_the_autoencoder_are_the_textbooks():
    assert autoencoders.reconstruction_loss(torch.zeros(1, 3, 2, 2), torch.ones(1, 3, 2, 2)).item() == 12.0
    assert autoencoders.kl_divergence(torch.zeros(1, 5), torch.zeros(1, 5)).item() == 0.0
    shifted = autoencoders.kl_divergence(torch.tensor([[2.0]]), torch.tensor([[math.log(0.25)]]))
    assert shifted.item() == pytest.approx(0.5 * (4.0 + 0.25 - math.log(0.25) - 1.0))


def test_a_linear_critic_of_slope_one_pays_no_penalty_and_of_slope_three_pays_four():
    points = torch.randn(8, 2, generator=torch.Generator().manual_seed(0))
    slope_one = wgan_gp.gradient_penalty(lambda x: x[:, 0], points, one_sided=False)
    slope_three = wgan_gp.gradient_penalty(lambda x: 3.0 * x[:, 0], points, one_sided=False)
    assert slope_one.item() == pytest.approx(0.0, abs=1e-6)
    assert slope_three.item() == pytest.approx(4.0, rel=1e-5)


def test_only_the_two_sided_penalty_punishes_a_flat_critic():
    points = torch.zeros(4, 2)
    flat = [
        wgan_gp.gradient_penalty(lambda x: 0.5 * x[:, 1], points, one_sided=s).item() for s in (True, False)
    ]
    assert flat == [pytest.approx(0.0), pytest.approx(0.25, rel=1e-5)]


def test_the_penalty_reaches_the_critics_weights():
    slope = torch.tensor(3.0, requires_grad=True)
    wgan_gp.gradient_penalty(lambda x: slope * x[:, 0], torch.ones(4, 2), one_sided=True).backward()
    assert slope.grad is not None
    assert slope.grad.item() == pytest.approx(2.0 * (3.0 - 1.0), rel=1e-5)


def test_the_interpolation_crosses_the_seam_instead_of_the_whole_circle():
    real, fake = torch.tensor([[math.pi - 0.1]]), torch.tensor([[-math.pi + 0.1]])
    middle = Joints(circles(1)).interpolate(fake, real, torch.tensor([[0.5]]))
    assert abs(math.remainder(middle.item() - math.pi, 2.0 * math.pi)) == pytest.approx(0.0, abs=1e-5)


def test_standardised_angles_are_interpolated_on_the_straight_line():
    real, fake = torch.full((8, 2), 3.0), torch.full((8, 1, 2), -3.0)
    between = tiny_module(critic_features="standardised").interpolate(real, fake)
    assert (between.abs() <= 3.0).all()
    assert (between[:, 0].abs() < 2.0).any()


@pytest.mark.parametrize(("first", "second"), [(1.0, 4.0), (-2.0, -7.0), (3.0, 3.0)])
def test_the_smooth_maximum_tends_to_the_maximum(first, second):
    value = wgan_gp.smooth_maximum(torch.tensor([first, second]), 1e-4)
    assert value.item() == pytest.approx(max(first, second), abs=1e-3)
    # Half an epsilon above equal values.
    equal = torch.tensor([first, first])
    assert wgan_gp.smooth_maximum(equal, 0.1).item() == pytest.approx(first + 0.05)


def test_the_fake_term_shifts_with_a_constant_added_to_the_critic():
    values = torch.tensor([[0.0, 1.0, -2.0, 0.5]])
    shift = wgan_gp.fake_term(values + 7.0, 0.1) - wgan_gp.fake_term(values, 0.1)
    assert shift.item() == pytest.approx(7.0, rel=1e-6)


def test_one_mean_has_no_maximum_to_smooth():
    values = torch.tensor([[2.0], [4.0]])
    assert torch.equal(wgan_gp.fake_term(values, 0.1), values[:, 0])
