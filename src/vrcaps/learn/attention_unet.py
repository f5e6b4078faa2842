"""U-Net with spatial attention: the generator of EndoL2H.

EndoL2H (Almalioglu et al., IEEE TMI 39(12), 2020) adds an attention block to the U-Net of Isola et
al. (CVPR 2017): each position attends to the features of all similar positions (Zhang et al., ICML
2019). Keys and values are pooled, so that large images fit into memory.
"""

from __future__ import annotations

from typing import Any

from vrcaps.learn.networks import require_torch

_POOLED = 4
"""Side of the pooling window of keys and values [px]."""
_NARROWER = 16
"""Reduction of the channels of queries, keys and values relative to the features."""
_WIDEST = 8
"""Maximum width of a level, relative to the first."""
_LEAK = 0.2


def attention_unet(features: int, halvings: int) -> Any:
    """Create a network that maps [b c h w] of any size to the same shape.

    Args:
        features: Channels c of the input, the output and the first level; they double per level, up
            to eight times that.
        halvings: Number of levels.
    """
    return _network_class()(features, halvings)


def _attention_class() -> Any:
    torch = require_torch()
    nn, functional = torch.nn, torch.nn.functional

    class SpatialAttention(nn.Module):
        """Attention of each position to similar positions; initially the identity."""

        def __init__(self, features: int) -> None:
            super().__init__()
            narrow = max(1, features // _NARROWER)
            self.query, self.key, self.value = (nn.Conv2d(features, narrow, 1) for _ in range(3))
            self.out = nn.Conv2d(narrow, features, 1)
            self.gain = nn.Parameter(torch.zeros(1))

        def forward(self, x: Any) -> Any:
            pooled = functional.avg_pool2d(x, _POOLED, ceil_mode=True)
            query, key, value = (
                maps.flatten(2).transpose(1, 2)[:, None]
                for maps in (self.query(x), self.key(pooled), self.value(pooled))
            )
            taken = functional.scaled_dot_product_attention(query, key, value)
            taken = taken[:, 0].transpose(1, 2).unflatten(2, x.shape[-2:])
            return x + self.gain * self.out(taken)

    return SpatialAttention


def _network_class() -> Any:
    torch, attention = require_torch(), _attention_class()
    nn, functional = torch.nn, torch.nn.functional

    class AttentionUnet(nn.Module):
        """Encoder and decoder with a skip connection at each level."""

        def __init__(self, features: int, halvings: int) -> None:
            super().__init__()
            more = (features * min(_WIDEST, 2**level) for level in range(halvings))
            widths = [features, *more]
            self.down = nn.ModuleList(
                nn.Conv2d(widths[k], widths[k + 1], 4, stride=2, padding=1) for k in range(halvings)
            )
            self.attention = attention(widths[1])
            self.up = nn.ModuleList(
                nn.Conv2d(widths[k + 1] + widths[k], widths[k], 3, padding=1)
                for k in range(halvings)
            )

        def forward(self, x: Any) -> Any:
            height, width = x.shape[-2:]
            step = 2 ** len(self.down)
            right, below = -width % step, -height % step
            if right or below:
                x = functional.pad(x, (0, right, 0, below), mode="replicate")
            levels = []
            for number, layer in enumerate(self.down):
                levels.append(x)
                x = functional.leaky_relu(normalized(layer(x)), _LEAK)
                x = self.attention(x) if number == 0 else x
            for layer, before in zip(reversed(self.up), reversed(levels), strict=True):
                x = functional.interpolate(functional.relu(x), scale_factor=2.0, mode="nearest")
                x = layer(torch.cat([x, before], dim=1))
                x = x if before is levels[0] else normalized(x)
            return x[..., :height, :width]

    def normalized(x: Any) -> Any:
        """Instance normalization, equal to batch normalization at the paper's batch size of 1."""
        return x if x.shape[-2] * x.shape[-1] == 1 else functional.instance_norm(x)

    return AttentionUnet
