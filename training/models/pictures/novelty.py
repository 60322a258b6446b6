"""What a VAE cannot draw again it has not seen: scores of a picture by the error of its reconstruction."""

import torch
from torch import Tensor, nn

from training.models.networks import Decoder


class NoveltyScores(nn.Module):
    """The mean squared error of the whole reconstruction, and of its worst part, an eighth of a side wide.

    The first tells another style of picture, the second one thing too many or out of place.

    Shapes: pictures (b, 3, P, P) in [-1, 1] and latent means (b, L) to (b, 2).
    """

    def __init__(self, decoder: Decoder, pixels: int) -> None:
        super().__init__()
        self.decoder = decoder
        self.part = nn.AvgPool2d(max(1, pixels // 8), stride=max(1, pixels // 24))

    def forward(self, pictures: Tensor, mu: Tensor) -> Tensor:
        """Both scores."""
        error = (self.decoder(mu) - pictures).square().mean(dim=1, keepdim=True)
        worst = self.part(error).amax(dim=(1, 2, 3))
        return torch.stack([error.mean(dim=(1, 2, 3)), worst], dim=1)
