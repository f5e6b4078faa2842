"""A second network that learns to tell estimated images from true ones, and the losses of both.

The discriminator is PatchGAN (Isola et al., CVPR 2017, section 3.2): it judges each patch of 70
pixels, given what the estimate was made of.
"""

from __future__ import annotations

from typing import Any

from vrcaps.learn.networks import require_torch

_LEAK = 0.2
"""Slope of the leaky rectifier below zero."""


def deceiving_loss(judged: Any) -> Any:
    """How sure a discriminator is, from its logits, that estimates are not true."""
    torch = require_torch()
    cross_entropy = torch.nn.functional.binary_cross_entropy_with_logits
    return cross_entropy(judged, torch.ones_like(judged))


def discriminating_loss(judged_true: Any, judged_estimate: Any) -> Any:
    """How wrong a discriminator is, from its logits for true images and for estimates."""
    return 0.5 * (deceiving_loss(judged_true) + deceiving_loss(-judged_estimate))


def patch_discriminator(features: int) -> Any:
    """A network from small images [b 3 h w] and large ones [b 3 fh fw] to logits [b 1 p q].

    Args:
        features: Channels of its first layer.
    """
    return _network_class()(features)


def _network_class() -> Any:
    torch = require_torch()
    nn, functional = torch.nn, torch.nn.functional

    class PatchDiscriminator(nn.Module):
        """Three halvings, then a logit for each patch."""

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
                # Over each image: what batches of one, as in the paper, are normalized by.
                x = x if number == 0 else functional.instance_norm(x)
                x = functional.leaky_relu(x, _LEAK)
            return last(x).float()

    return PatchDiscriminator
