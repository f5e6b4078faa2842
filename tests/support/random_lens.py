"""Lenses of every kind with random parameters."""

from __future__ import annotations

import numpy as np

from vrcaps.camera.lens import (
    Lens,
    LensEquidistant,
    LensEquirectangular,
    LensKannalaBrandt,
    LensPinhole,
    LensScaramuzza,
)


def random_lens(kind: str, rng: np.random.Generator) -> Lens:
    """A lens for a 200-pixel image, from mild to folding over within it."""
    f, cx, cy = rng.uniform(40, 160), rng.uniform(90, 110), rng.uniform(90, 110)
    limit = None if rng.random() < 0.5 else rng.uniform(0.3, 1.5)
    match kind:
        case "pinhole":
            k1, k2, k3 = rng.uniform(-0.4, 0.4, 3) * (1.0, 0.5, 0.2)
            p1, p2 = rng.uniform(-0.01, 0.01, 2) * (rng.random() < 0.7)
            skew = rng.uniform(-2, 2)
            return LensPinhole(f, 1.1 * f, cx, cy, skew, k1, k2, p1, p2, k3, limit)
        case "kannala-brandt":
            return LensKannalaBrandt(f, 0.9 * f, cx, cy, *rng.uniform(-0.2, 0.2, 4), limit)
        case "scaramuzza":
            a2, a3, a4 = rng.uniform(-0.5, 0.5, 3) / (f, f**2, f**3)
            c, d, e = rng.uniform(-0.05, 0.05, 3)
            return LensScaramuzza(f, a2, a3, a4, cx, cy, 1.0 + c, d, e, limit)
        case "equidistant":
            return LensEquidistant(f, cx, cy, limit)
        case "equirectangular":
            return LensEquirectangular(f, 1.1 * f, cx, cy, limit)
    raise AssertionError(kind)
