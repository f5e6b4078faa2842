"""Perceptual losses: differences of image features of a network pre-trained on ImageNet.

Content and style follow Gatys et al. (CVPR 2016), as losses for image transformation by Johnson et
al. (ECCV 2016). The distance follows Zhang et al. (CVPR 2018), without their trained weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.learn.networks import feature_network, require_torch

if TYPE_CHECKING:
    from jaxtyping import UInt8

_TINY = 1e-10


def content_loss(found: Sequence[Any], wanted: Sequence[Any]) -> Any:
    """Mean squared difference of feature maps [b c h w], mean over maps (Johnson 2016, eq. 2)."""
    return sum(((f - w) ** 2).mean() for f, w in zip(found, wanted, strict=True)) / len(found)


def style_loss(found: Sequence[Any], wanted: Sequence[Any]) -> Any:
    """Squared Frobenius norm of the difference of Gram matrices, mean over images and maps.

    See Johnson 2016, eq. 4.
    """
    differences = (
        ((gram_matrix(f) - gram_matrix(w)) ** 2).sum(dim=(1, 2)).mean()
        for f, w in zip(found, wanted, strict=True)
    )
    return sum(differences) / len(found)


def gram_matrix(features: Any) -> Any:
    """Gram matrix [b c c] of feature maps [b c h w], divided by c h w (Johnson, eq. 3)."""
    rows = features.flatten(2)
    return rows @ rows.transpose(1, 2) / (rows.shape[1] * rows.shape[2])


def feature_distance(
    estimate: UInt8[np.ndarray, "h w 3"], truth: UInt8[np.ndarray, "h w 3"], encoder: str
) -> float:
    """Squared difference of unit-normalized features, mean over pixels and maps; 0 to 4.

    It equals LPIPS (Zhang 2018, eq. 1) with all weights 1 and another network, so its values are
    comparable only for the same network.

    Args:
        estimate: Predicted image.
        truth: Ground truth of the same size.
        encoder: Network whose features are compared, by its timm name.

    Raises:
        MissingExtraError: If the network's weights are not installed.
    """
    torch = require_torch()
    both = np.ascontiguousarray(np.moveaxis(np.stack([estimate, truth]), -1, 1))
    with torch.inference_mode():
        maps = feature_network(encoder, "cpu")(torch.from_numpy(both).float() / 255.0)
        unit = [m / (m.norm(dim=1, keepdim=True) + _TINY) for m in maps]
        return float(sum(((m[0] - m[1]) ** 2).sum(dim=0).mean() for m in unit) / len(unit))
