"""Features of views: EfficientNet-Lite0 with ImageNet weights, at three depths."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

LEVELS = ("block 3", "block 5", "pooled")
"""Levels of the network: mean and standard deviation of the 40 channels after its third block
(texture), of the 112 after its fifth, and the 1280 channels that its classifier takes (content)."""

_SIDE = 224
_BATCH = 16


def view_features(
    views: UInt8[np.ndarray, "n s s 3"],
    *,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Float[np.ndarray, "n d"]]:
    """Features of views by level.

    Args:
        views: sRGB views.
        progress: Called with the number of views done and their total.

    Raises:
        MissingExtraError: If PyTorch or the weights are not installed.
    """
    from vrcaps.core.errors import import_extra

    torch, timm = import_extra("torch", "learn"), import_extra("timm", "learn")
    from vrcaps.learn.networks import ENCODER, imagenet_weights

    network = timm.create_model(ENCODER, pretrained=False)
    network.load_state_dict(imagenet_weights())
    network.eval()
    settings = timm.data.resolve_data_config({}, model=network)
    mean, spread = (np.array(settings[key], np.float32) for key in ("mean", "std"))
    rows: dict[str, list[np.ndarray]] = {level: [] for level in LEVELS}
    with torch.inference_mode():
        for first in range(0, len(views), _BATCH):
            batch = np.stack([_scaled(view) for view in views[first : first + _BATCH]])
            normal = ((batch / np.float32(255.0)) - mean) / spread
            maps = network.bn1(network.conv_stem(torch.from_numpy(normal).permute(0, 3, 1, 2)))
            for index, block in enumerate(network.blocks):
                maps = block(maps)
                if index in (2, 4):
                    moments = torch.cat([maps.mean((2, 3)), maps.std((2, 3))], 1)
                    rows[f"block {index + 1}"].append(moments.numpy())
            rows["pooled"].append(network.bn2(network.conv_head(maps)).mean((2, 3)).numpy())
            if progress is not None:
                progress(min(first + _BATCH, len(views)), len(views))
    return {level: np.concatenate(parts).astype(float) for level, parts in rows.items()}


def _scaled(view: UInt8[np.ndarray, "s s 3"]) -> Float[np.ndarray, "k k 3"]:
    from PIL import Image

    image = Image.fromarray(view).resize((_SIDE, _SIDE), Image.Resampling.BICUBIC)
    return np.asarray(image, np.float32)
