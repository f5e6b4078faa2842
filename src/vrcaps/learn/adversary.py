"""Discriminator of an adversarial loss, and the losses of generator and discriminator.

The discriminator is PatchGAN (Isola et al., CVPR 2017, section 3.2): it classifies each patch of 70
pixels, conditioned on the generator's input.
"""

from __future__ import annotations

from typing import Any

from vrcaps.learn.networks import require_torch

_LEAK = 0.2
"""Negative slope of the leaky ReLU."""


def deceiving_loss(judged: Any) -> Any:
    """Loss of the generator, from the discriminator's logits for predictions."""
    torch = require_torch()
    cross_entropy = torch.nn.functional.binary_cross_entropy_with_logits
    return cross_entropy(judged, torch.ones_like(judged))


def discriminating_loss(judged_true: Any, judged_estimate: Any) -> Any:
    """Loss of the discriminator, from its logits for true images and for predictions."""
    return 0.5 * (deceiving_loss(judged_true) + deceiving_loss(-judged_estimate))


def patch_discriminator(features: int) -> Any:
    """Create a network from small images [b 3 h w] and large ones [b 3 fh fw] to logits [b 1 p q].

    Args:
        features: Number of channels of the first layer.
    """
    return _network_class()(features)


def _network_class() -> Any:
    torch = require_torch()
    nn, functional = torch.nn, torch.nn.functional

    class PatchDiscriminator(nn.Module):
        """Three stride-2 convolutions, then one logit per patch."""

        def __init__(self, features: int) -> None:
            super().__init__()
            widths = (6, features, 2 * features, 4 * features, 8 * features, 1)
            strides = (2, 2, 2, 1, 1)
            self.layers = nn.ModuleList(
                nn.Conv2d(before, after, 4, stride=stride, padding=1)
                for before, after, stride in zip(widths, widths[1:], strides, strict=False)
            )

        def forward(self, small: Any, large: Any) -> Any:
            base = functional.interpolate(
                small, size=large.shape[-2:], mode="bicubic", align_corners=False
            )
            x = 2.0 * torch.cat([base, large], dim=1) - 1.0
            *layers, last = self.layers
            for number, layer in enumerate(layers):
                x = layer(x)
                # Per image, which equals batch normalization at the paper's batch size of 1.
                x = x if number == 0 else functional.instance_norm(x)
                x = functional.leaky_relu(x, _LEAK)
            return last(x).float()

    return PatchDiscriminator
