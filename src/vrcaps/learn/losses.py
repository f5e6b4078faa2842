"""Loss terms and the geometry that they need.

Perceptual losses compare image features of a network pre-trained on ImageNet. Content and style
follow Gatys et al. (CVPR 2016), as losses for image transformation by Johnson et al. (ECCV 2016).
The distance follows Zhang et al. (CVPR 2018), without their trained weights.

View synthesis predicts a frame from a neighbor, differentiably and for any lens.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from vrcaps.learn.networks import feature_network
from vrcaps.learn.picture_border import Letterbox

if TYPE_CHECKING:
    from jaxtyping import UInt8

    from vrcaps.camera.camera import Camera

_TINY = 1e-10
_SSIM_1, _SSIM_2 = 0.01**2, 0.03**2
"""Constants of SSIM for values from 0 to 1 (Wang et al., IEEE TIP 13(4), 2004)."""
_SSIM_WEIGHT = 0.85


def generator_loss(logits: Tensor) -> Tensor:
    """Loss of the generator, from the discriminator's logits for predictions."""
    return functional.binary_cross_entropy_with_logits(logits, torch.ones_like(logits))


def discriminator_loss(target_logits: Tensor, output_logits: Tensor) -> Tensor:
    """Loss of the discriminator, from its logits for true images and for predictions."""
    return 0.5 * (generator_loss(target_logits) + generator_loss(-output_logits))


def content_loss(outputs: Sequence[Tensor], targets: Sequence[Tensor]) -> Tensor:
    """Mean squared difference of feature maps [b c h w], mean over maps (Johnson 2016, eq. 2)."""
    return _sum(((f - t) ** 2).mean() for f, t in zip(outputs, targets, strict=True)) / len(outputs)


def style_loss(outputs: Sequence[Tensor], targets: Sequence[Tensor]) -> Tensor:
    """Squared Frobenius norm of the difference of Gram matrices, mean over images and maps.

    See Johnson 2016, eq. 4.
    """
    differences = (
        ((gram_matrix(f) - gram_matrix(t)) ** 2).sum(dim=(1, 2)).mean()
        for f, t in zip(outputs, targets, strict=True)
    )
    return _sum(differences) / len(outputs)


def gram_matrix(features: Tensor) -> Tensor:
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
    both = np.ascontiguousarray(np.moveaxis(np.stack([estimate, truth]), -1, 1))
    with torch.inference_mode():
        maps = feature_network(encoder, "cpu")(torch.from_numpy(both).float() / 255.0)
        unit = [m / (m.norm(dim=1, keepdim=True) + _TINY) for m in maps]
        return float(_sum(((m[0] - m[1]) ** 2).sum(dim=0).mean() for m in unit) / len(unit))


def _sum(terms: Iterable[Tensor]) -> Tensor:
    return cast(Tensor, sum(terms))


@dataclass(frozen=True)
class SynthesizedView:
    """A frame predicted from a neighbor.

    Attributes:
        color: Colors sampled from the neighbor [b 3 s s].
        distance: The neighbor's own distance there [b s s].
        moved: Distance of the transformed points from the neighbor [b s s].
        is_valid: Whether a pixel has a ray and its point is in the neighbor's image [b s s].
    """

    color: Tensor
    distance: Tensor
    moved: Tensor
    is_valid: Tensor


def synthesize_view(
    neighbor: Tensor,
    neighbor_output: Tensor,
    own_output: Tensor,
    T_other_own: Tensor,
    ray: Tensor,
    views: Sequence[tuple[Letterbox, Camera]],
) -> SynthesizedView:
    """Predict a frame from a neighbor.

    Args:
        neighbor: Colors [b 3 s s].
        neighbor_output: ln of the neighbor's distances [b 1 s s].
        own_output: ln of the frame's distances [b 1 s s].
        T_other_own: Pose of the frame's camera in the neighbor's [b 4 4].
        ray: Unit rays [b 3 s s], zero where the lens has none.
        views: Letterbox transform and camera of each image.
    """
    size = ray.shape[-1]
    points = torch.exp(own_output) * ray
    flat = points.flatten(2)
    moved = T_other_own[:, :3, :3] @ flat + T_other_own[:, :3, 3:]
    has_ray = (ray.abs().sum(dim=1) > 0.0).flatten(1)
    grids = []
    for point, (letterbox, camera) in zip(moved.transpose(1, 2), views, strict=True):
        project = cast("Callable[[Tensor], Tensor]", camera.lens.project)
        column, row = letterbox.to_square(project(point))
        grids.append(torch.stack([column, row], dim=-1))
    pixel = torch.stack(grids)
    grid = ((2.0 * pixel + 1.0) / size - 1.0).to(neighbor.dtype)
    inside = torch.isfinite(grid).all(dim=-1) & (grid.abs() < 1.0).all(dim=-1) & has_ray
    grid = torch.where(inside[..., None], grid, torch.zeros_like(grid)).view(-1, size, size, 2)
    sampled = functional.grid_sample(
        torch.cat([neighbor, torch.exp(neighbor_output)], dim=1),
        grid,
        mode="bilinear",
        padding_mode="border",
        align_corners=False,
    )
    length = moved.norm(dim=1).view(-1, size, size)
    return SynthesizedView(sampled[:, :3], sampled[:, 3], length, inside.view(-1, size, size))


def inconsistency(view: SynthesizedView) -> Tensor:
    """|D − D'| / (D + D') [b s s], 0 to 1."""
    return (view.moved - view.distance).abs() / (view.moved + view.distance)


def match_brightness(color: Tensor, image: Tensor, is_valid: Tensor) -> Tensor:
    """Scale colors [b 3 s s] to the image's mean and standard deviation on the valid pixels."""
    weight = is_valid[:, None].to(color.dtype)
    count = weight.sum(dim=(2, 3), keepdim=True).clamp(min=1.0)

    def moments(values: Tensor) -> tuple[Tensor, Tensor]:
        mean = (values * weight).sum(dim=(2, 3), keepdim=True) / count
        square = ((values - mean) ** 2 * weight).sum(dim=(2, 3), keepdim=True) / count
        return mean, (square + 1e-6).sqrt()

    (mean, spread), (goal, width) = moments(color), moments(image)
    return (color - mean) / spread * width + goal


def photometric_error(color: Tensor, image: Tensor) -> Tensor:
    """Photometric difference by color value and by SSIM [b s s]."""
    plain = (color - image).abs().mean(dim=1)
    return (1.0 - _SSIM_WEIGHT) * plain + _SSIM_WEIGHT * _dissimilarity(color, image)


def _dissimilarity(color: Tensor, image: Tensor) -> Tensor:
    """(1 − SSIM) / 2 in windows of 3 × 3 pixels [b s s]."""

    def mean(values: Tensor) -> Tensor:
        return functional.avg_pool2d(functional.pad(values, (1, 1, 1, 1), mode="reflect"), 3, 1)

    a, b = mean(color), mean(image)
    aa, bb = mean(color**2) - a * a, mean(image**2) - b * b
    ab = mean(color * image) - a * b
    over = (2.0 * a * b + _SSIM_1) * (2.0 * ab + _SSIM_2)
    under = (a * a + b * b + _SSIM_1) * (aa + bb + _SSIM_2)
    return ((1.0 - over / under) / 2.0).clamp(0.0, 1.0).mean(dim=1)


def smoothness(output: Tensor, image: Tensor) -> Tensor:
    """Mean gradient of mean-normalized inverse distance, weighted down at image edges."""
    inverse = torch.exp(-output)
    inverse = inverse / inverse.mean(dim=(2, 3), keepdim=True)
    result = torch.zeros((), device=output.device)
    for axis in (2, 3):
        slope = torch.diff(inverse, dim=axis).abs()
        edge = torch.diff(image, dim=axis).abs().mean(dim=1, keepdim=True)
        result = result + (slope * torch.exp(-edge)).mean()
    return result


def pose_matrix(motion: Tensor) -> Tensor:
    """Pose [b 4 4] of a rotation vector [rad] and a translation [b 6]."""
    vector, shift = motion[:, :3], motion[:, 3:]
    zero = torch.zeros_like(vector[:, 0])
    x, y, z = vector.unbind(dim=1)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=1).view(-1, 3, 3)
    rotation = torch.linalg.matrix_exp(cross)
    top = torch.cat([rotation, shift[:, :, None]], dim=2)
    last = torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=top.dtype, device=top.device)
    return torch.cat([top, last.expand(len(top), 1, 4)], dim=1)
