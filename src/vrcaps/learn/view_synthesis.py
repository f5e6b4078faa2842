"""View synthesis: differentiable prediction of a frame from a neighbor, for any lens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from vrcaps.learn.letterbox import Letterbox
from vrcaps.learn.networks import require_torch

if TYPE_CHECKING:
    from vrcaps.camera.camera import Camera

_SSIM_1, _SSIM_2 = 0.01**2, 0.03**2
"""Constants of SSIM for values from 0 to 1 (Wang et al., IEEE TIP 13(4), 2004)."""
_SSIM_SHARE = 0.85


@dataclass(frozen=True)
class Predicted:
    """A frame predicted from a neighbor.

    Attributes:
        color: Colors sampled from the neighbor [b 3 s s].
        distance: The neighbor's own distance there [b s s].
        moved: Distance of the transformed points from the neighbor [b s s].
        is_valid: Whether a pixel has a ray and its point is in the neighbor's image [b s s].
    """

    color: Any
    distance: Any
    moved: Any
    is_valid: Any


def predicted(
    neighbor: Any,
    neighbor_output: Any,
    own_output: Any,
    T_other_own: Any,
    ray: Any,
    views: Sequence[tuple[Letterbox, Camera]],
) -> Predicted:
    """Predict a frame from a neighbor.

    Args:
        neighbor: Colors [b 3 s s].
        neighbor_output: ln of the neighbor's distances [b 1 s s].
        own_output: ln of the frame's distances [b 1 s s].
        T_other_own: Pose of the frame's camera in the neighbor's [b 4 4].
        ray: Unit rays [b 3 s s], zero where the lens has none.
        views: Letterbox transform and camera of each image.
    """
    torch = require_torch()
    size = ray.shape[-1]
    points = torch.exp(own_output) * ray
    flat = points.flatten(2)
    moved = T_other_own[:, :3, :3] @ flat + T_other_own[:, :3, 3:]
    has_ray = (ray.abs().sum(dim=1) > 0.0).flatten(1)
    grids = []
    for place, (fit, camera) in zip(moved.transpose(1, 2), views, strict=True):
        column, row = fit.to_square(camera.lens.project(place))
        grids.append(torch.stack([column, row], dim=-1))
    pixel = torch.stack(grids)
    grid = ((2.0 * pixel + 1.0) / size - 1.0).to(neighbor.dtype)
    inside = torch.isfinite(grid).all(dim=-1) & (grid.abs() < 1.0).all(dim=-1) & has_ray
    grid = torch.where(inside[..., None], grid, torch.zeros_like(grid)).view(-1, size, size, 2)
    taken = torch.nn.functional.grid_sample(
        torch.cat([neighbor, torch.exp(neighbor_output)], dim=1),
        grid,
        mode="bilinear",
        padding_mode="border",
        align_corners=False,
    )
    length = moved.norm(dim=1).view(-1, size, size)
    return Predicted(taken[:, :3], taken[:, 3], length, inside.view(-1, size, size))


def inconsistency_of(found: Predicted) -> Any:
    """|D − D'| / (D + D') [b s s], 0 to 1."""
    return (found.moved - found.distance).abs() / (found.moved + found.distance)


def matched_brightness(color: Any, image: Any, is_valid: Any) -> Any:
    """Scale colors [b 3 s s] to the image's mean and standard deviation on the valid pixels."""
    weight = is_valid[:, None].to(color.dtype)
    count = weight.sum(dim=(2, 3), keepdim=True).clamp(min=1.0)

    def moments(values: Any) -> tuple[Any, Any]:
        mean = (values * weight).sum(dim=(2, 3), keepdim=True) / count
        square = ((values - mean) ** 2 * weight).sum(dim=(2, 3), keepdim=True) / count
        return mean, (square + 1e-6).sqrt()

    (mean, spread), (goal, width) = moments(color), moments(image)
    return (color - mean) / spread * width + goal


def photometric_error(color: Any, image: Any) -> Any:
    """Photometric difference by color value and by SSIM [b s s]."""
    plain = (color - image).abs().mean(dim=1)
    return (1.0 - _SSIM_SHARE) * plain + _SSIM_SHARE * _dissimilarity(color, image)


def _dissimilarity(color: Any, image: Any) -> Any:
    """(1 − SSIM) / 2 in windows of 3 × 3 pixels [b s s]."""
    functional = require_torch().nn.functional

    def mean(values: Any) -> Any:
        return functional.avg_pool2d(functional.pad(values, (1, 1, 1, 1), mode="reflect"), 3, 1)

    a, b = mean(color), mean(image)
    aa, bb = mean(color**2) - a * a, mean(image**2) - b * b
    ab = mean(color * image) - a * b
    over = (2.0 * a * b + _SSIM_1) * (2.0 * ab + _SSIM_2)
    under = (a * a + b * b + _SSIM_1) * (aa + bb + _SSIM_2)
    return ((1.0 - over / under) / 2.0).clamp(0.0, 1.0).mean(dim=1)


def smoothness(output: Any, image: Any) -> Any:
    """Mean gradient of mean-normalized inverse distance, weighted down at image edges."""
    torch = require_torch()
    inverse = torch.exp(-output)
    inverse = inverse / inverse.mean(dim=(2, 3), keepdim=True)
    total = 0.0
    for axis in (2, 3):
        slope = torch.diff(inverse, dim=axis).abs()
        edge = torch.diff(image, dim=axis).abs().mean(dim=1, keepdim=True)
        total = total + (slope * torch.exp(-edge)).mean()
    return total


def matrix_of(motion: Any) -> Any:
    """Pose [b 4 4] of a rotation vector [rad] and a translation [b 6]."""
    torch = require_torch()
    vector, shift = motion[:, :3], motion[:, 3:]
    zero = torch.zeros_like(vector[:, 0])
    x, y, z = vector.unbind(dim=1)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=1).view(-1, 3, 3)
    rotation = torch.linalg.matrix_exp(cross)
    top = torch.cat([rotation, shift[:, :, None]], dim=2)
    last = torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=top.dtype, device=top.device)
    return torch.cat([top, last.expand(len(top), 1, 4)], dim=1)
