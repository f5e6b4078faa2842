"""Readable NumPy twin of turbid fluid (`rust/src/render/medium.rs`) and of forward scattering."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

_RAYS, _SLICES, _ORDERS, _OCTAVES = 40, 16, 5, 3
_FARTHEST, _SCALE, _OCTAVE_SCALE = 0.1, 0.322, 0.264
_TURN = Rotation.from_rotvec(np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)).as_matrix()


def gradient(point: np.ndarray, seed: int) -> np.ndarray:
    """Components from −1 to 1 [n 3] of integer points [n 3]."""
    x = np.full(point.shape[:-1], seed, np.uint32)
    with np.errstate(over="ignore"):
        for k, factor in enumerate((0x8DA6B343, 0xD8163841, 0xCB1AB31F)):
            x ^= point[..., k].astype(np.int32).view(np.uint32) * np.uint32(factor)
            x = ((x << np.uint32(13)) | (x >> np.uint32(19))) * np.uint32(5) + np.uint32(0xE6546B64)
        x ^= x >> np.uint32(16)
        x *= np.uint32(0x85EBCA6B)
        x ^= x >> np.uint32(13)
        x *= np.uint32(0xC2B2AE35)
        x ^= x >> np.uint32(16)
    return np.stack([(x >> np.uint32(shift)) & 1023 for shift in (0, 10, 20)], -1) / 511.5 - 1.0


def noise(point: np.ndarray, seed: int) -> np.ndarray:
    """Gradient noise at points [n 3]."""
    cell = np.floor(point)
    offset = point - cell
    t = offset * offset * (3.0 - 2.0 * offset)
    value = np.zeros(point.shape[:-1])
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(np.array(corner) == 1, t, 1.0 - t), axis=-1)
        slope = gradient((cell + corner).astype(np.int64), seed)
        value += weight * (slope * (offset - corner)).sum(axis=-1)
    return value


def fractal(point: np.ndarray, seed: int) -> np.ndarray:
    """Sum of octaves of gradient noise at points [n 3]."""
    total, at, height = np.zeros(point.shape[:-1]), point, 1.0
    for octave in range(_OCTAVES):
        at = at @ _TURN.T
        total += height * noise(at, (seed + octave * 0x632BE5AB) % 2**32)
        at, height = 2.1 * at, height * 0.6
    return total / _SCALE


MEAN_FLOCS = 0.016
"""Extinction by flocs averaged over space, relative to that inside them."""


def density(
    medium: Mapping[str, Any], point: np.ndarray, between: np.ndarray | float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Density relative to the mean, and extinction by flocs [1/m], at points [n 3].

    Flocs fade to their mean where they are less than four rays, `between` apart, apart.
    """
    (spread, size), (extinction, apart) = medium["clouds"], medium["flocs"]
    clouds, flocs = np.ones(point.shape[:-1]), np.zeros(point.shape[:-1])
    if spread > 0.0:
        x, y, z = np.moveaxis(point, -1, 0)
        wisps = fractal(np.stack([x, y + 0.5 * z, 0.4 * z], axis=-1) / size, medium["seed"])
        clouds = np.exp(spread * wisps - 0.5 * spread**2)
    if extinction > 0.0:
        flakes = noise(point / apart @ _TURN.T, medium["seed"] ^ 0x9E3779B9) / _OCTAVE_SCALE
        t = np.clip((flakes - 1.2) / 0.6, 0.0, 1.0)
        resolved = np.clip(0.5 * apart / np.maximum(between, 1e-9) - 1.0, 0.0, 1.0)
        flocs = extinction * (MEAN_FLOCS + resolved * (t * t * (3.0 - 2.0 * t) - MEAN_FLOCS))
    return clouds, flocs


def _leds(leds: np.ndarray, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Irradiance [k n 3] and distance [k n] of each LED at points [n 3]."""
    way = point - leds[:, None, :3]
    length = np.linalg.norm(way, axis=-1)
    cosine = np.einsum("kni,ki->kn", way, leds[:, 3:6]) / length
    lobe = np.maximum(cosine, 0.0) ** leds[:, None, 9]
    return leds[:, None, 6:9] * (lobe / length**2)[..., None], length


def _node(leds, point, ratio_of, depth, veil, scattered):
    arrives, length = _leds(leds, point)
    ratio = ratio_of(length)[..., None]
    all_light = arrives.sum(axis=0)
    lit = (arrives * np.exp(-depth * ratio)).sum(axis=0)
    led = np.where(all_light > 0.0, lit / np.maximum(all_light, 1e-30), np.exp(-depth))
    return np.concatenate([veil, np.exp(-depth), led, scattered[:, None]], axis=-1)


def integrals(rays, start, farthest, pose, leds, medium, cell=0.0):
    """Values of all nodes [n slices+1 10] along rays [n 3] with an angle `cell` between them."""
    absorption, scattering, orders, color = (
        np.array(medium[k]) for k in ("absorption", "scattering", "orders", "floc_color")
    )
    g = medium["anisotropy"]
    depth, veil, scattered = np.zeros_like(rays), np.zeros_like(rays), np.zeros(len(rays))
    length, at = np.maximum(farthest - start, 1e-6), start

    def ratio_of(distance):
        def ratio(way):
            return np.maximum(way - start, 0.0) / np.maximum(distance - start, 1e-6)

        return ratio

    nodes = [_node(leds, rays * at[:, None], ratio_of(at), depth, veil, scattered)]
    for part in np.arange(1, _SLICES + 1) / _SLICES:
        to = start + length * part**2
        step, middle = (to - at)[:, None], 0.5 * (at + to)
        point = rays * middle[:, None]
        fixed = point @ pose[:3, :3].T + pose[:3, 3]
        cloud, floc = (x[:, None] for x in density(medium, fixed, cell * middle))
        back = cloud * (1.0 - g) * scattering + floc * color
        gone = cloud * (absorption + (1.0 - g) * scattering) + floc + np.array(medium["stain"])
        halfway = depth + 0.5 * step * gone
        arrives, way = _leds(leds, point)
        transmitted = np.exp(-halfway * (1.0 + ratio_of(middle)(way)[..., None]))
        series = sum(
            transmitted ** (0.5**k)
            * (0.5 * orders) ** k
            / np.where(k == _ORDERS - 1, 1.0 - orders, 1.0)
            for k in range(_ORDERS)
        )
        veil = veil + step * back * (arrives * series).sum(axis=0) / (4.0 * np.pi)
        depth = depth + step * gone
        scattered = scattered + (step * cloud)[:, 0] * g * scattering[1]
        nodes.append(_node(leds, rays * to[:, None], ratio_of(to), depth, veil, scattered))
        at = to
    return np.stack(nodes, axis=1)


def _spline(at, offset, count):
    """Node around a coordinate and its weight, of the quadratic B-spline."""
    middle = np.round(at)
    away = np.abs(at - middle - offset)
    weight = np.where(away < 0.5, 0.75 - away**2, 0.5 * np.clip(1.5 - away, 0.0, None) ** 2)
    return np.clip(middle.astype(int) + offset, 0, count - 1), weight


def immerse(planes, rays, distance, start, pose, leds, medium):
    """Twin of the core's function of this name."""
    height, width = distance.shape
    grid = -(-max(height, width) // _RAYS)
    known = distance[np.isfinite(distance)]
    farthest = min(known.max(), _FARTHEST) if known.size and known.max() > 0 else _FARTHEST
    rows = np.minimum(np.arange(-(-height // grid) + 1) * grid, height - 1)
    columns = np.minimum(np.arange(-(-width // grid) + 1) * grid, width - 1)
    node_rays = rays[np.ix_(rows, columns)].astype(float)
    is_lit = np.isfinite(node_rays).all(axis=-1)
    nodes = np.zeros((*is_lit.shape, _SLICES + 1, 10))
    node_start = start[np.ix_(rows, columns)][is_lit].astype(float)
    middle, right = height // 2, width // 2
    apart = rays[middle, right] - rays[middle, right + min(grid, width - 1 - right)].astype(float)
    cell = float(np.nan_to_num(np.linalg.norm(apart)))
    nodes[is_lit] = integrals(node_rays[is_lit], node_start, farthest, pose, leds, medium, cell)
    y, x = np.mgrid[:height, :width]
    known_distance = np.where(np.isfinite(distance), distance, _FARTHEST)
    along = np.clip((known_distance - start) / np.maximum(farthest - start, 1e-6), 0.0, 1.0)
    along = np.sqrt(along) * _SLICES
    slice_ = np.minimum(along.astype(int), _SLICES - 1)
    t, total, whole = (along - slice_)[..., None], 0.0, 0.0
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            row, v = _spline(y / grid, down, len(rows))
            column, u = _spline(x / grid, right, len(columns))
            weight = (v * u * is_lit[row, column])[..., None]
            near, far = nodes[row, column, slice_], nodes[row, column, slice_ + 1]
            total, whole = total + weight * (near + t * (far - near)), whole + weight
    seen = np.isfinite(rays).all(axis=-1) & (whole[..., 0] > 0.0)
    node = np.where(seen[..., None], total / np.where(whole > 0.0, whole, 1.0), 0.0)
    left = np.where(seen[..., None], node[..., 3:6] * node[..., 6:9], 1.0)
    planes *= np.moveaxis(left, -1, 0).astype(np.float32)
    veil = np.moveaxis(node[..., :3], -1, 0).astype(np.float32)
    return veil, np.where(seen, np.exp(-node[..., 9]), 1.0).astype(np.float32)


def scatter_forward(planes, lit, fraction, sigma):
    """Twin of the core's function of this name."""
    whole = gaussian_filter(lit.astype(float), sigma, mode="constant", truncate=3.0)
    for plane in planes:
        soft = gaussian_filter(np.where(lit, plane, 0.0), sigma, mode="constant", truncate=3.0)
        mixed = plane + fraction * (soft / np.maximum(whole, 1e-9) - plane)
        plane[...] = np.where(lit, mixed, plane)
