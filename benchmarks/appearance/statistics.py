"""Distances between simulated and real frames, and among real ones: color, gradient, highlights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vrcaps import _core
from vrcaps.core.color import linear_from_srgb
from vrcaps.metrics.images import (
    ImageColor,
    color_distance,
    highlights,
    image_color,
    wasserstein,
)

RESAMPLES = 1000
STATISTICS = ("mean", "spread", "gradient", "highlights")

Discs = list[np.ndarray]


@dataclass(frozen=True)
class Measured:
    """Statistics of one image.

    Attributes:
        color: In CIE L*a*b*.
        fraction: Of the view that is highlights [%].
        spots: Number of highlights.
    """

    color: ImageColor
    fraction: float
    spots: int


def measured(images: Discs, valid: np.ndarray) -> list[Measured]:
    """Statistics of images."""
    found = [(image_color(image, valid), *highlights(image, valid)) for image in images]
    return [Measured(color, 100.0 * fraction, spots) for color, fraction, spots in found]


def totals(ours: list[Measured], real: list[Measured]) -> np.ndarray:
    """Distance in each of `STATISTICS`, over L*, a* and b* together if it has these."""
    found = color_distance([m.color for m in ours], [m.color for m in real])
    apart = [float(np.linalg.norm(getattr(found, name))) for name in STATISTICS[:3]]
    fractions = [np.array([m.fraction for m in side]) for side in (ours, real)]
    return np.array([*apart, wasserstein(*fractions)])


def bootstrap(ours: list[Measured], theirs: list[Measured], real: list[Measured]) -> np.ndarray:
    """Distances [resample, side, statistic] of bootstrap resamples of the images of each set."""
    rng = np.random.default_rng(3)

    def drawn(images: list[Measured]) -> list[Measured]:
        return [images[k] for k in rng.integers(len(images), size=len(images))]

    found = []
    for _ in range(RESAMPLES):
        anew = drawn(real)
        found.append([totals(drawn(ours), anew), totals(drawn(theirs), anew)])
    return np.array(found)


def compare(
    name: str, discs: dict[str, Discs], valid: np.ndarray
) -> tuple[list[tuple[str, ...]], list[tuple[str, ...]]]:
    """Rows of the main table and of the table by channel.

    The tuning half is the even real frames, held out are the odd ones.

    Args:
        name: Of the class.
        discs: Discs of `ours`, `real`, `VR-Caps` and, if stored, `before`.
        valid: Pixels that count.
    """
    sets = {side: measured(images, valid) for side, images in discs.items()}
    ours, theirs, real = (sets[side] for side in ("ours", "VR-Caps", "real"))
    blind = measured(refitted(discs["ours"], discs["real"], valid), valid)
    found = np.array([totals(ours, real), totals(theirs, real)])
    held_out = np.array([totals(blind, real[1::2]), totals(theirs, real[1::2])])
    drawn = bootstrap(blind, theirs, real[1::2])
    low, high = np.quantile(drawn, (0.05, 0.95), axis=0)
    wins = (drawn[:, 0] < drawn[:, 1]).mean(axis=0)
    before = [f"{x:.2f}" for x in totals(sets["before"], real)] if "before" in sets else ["–"] * 4
    rows = []
    for k, statistic in enumerate(STATISTICS):
        cells = [
            f"{held_out[side, k]:.2f} ({low[side, k]:.2f}–{high[side, k]:.2f})" for side in (0, 1)
        ]
        closer = ["yes" if x[0, k] < x[1, k] else "**no**" for x in (found, held_out)]
        rows.append(
            (
                *(f"{name} ({len(real[::2])} + {len(real[1::2])})", statistic, before[k]),
                *(f"{found[0, k]:.2f}", f"{found[1, k]:.2f}", *cells, f"{100 * wins[k]:.0f} %"),
                " / ".join(closer),
            )
        )
    return rows, by_channel(name, sets)


def refitted(ours: Discs, real: Discs, valid: np.ndarray) -> Discs:
    """Simulated frames with palettes fitted to the tuning half of the real frames alone.

    See `refitted_gains`.
    """
    gains = refitted_gains(real, valid)
    return [
        _core.encode_srgb((linear_from_srgb(image) * gains).astype(np.float32), 1.0)
        for image in ours
    ]


def refitted_gains(real: Discs, valid: np.ndarray) -> np.ndarray:
    """Gains of red, green and blue between palettes fitted to half and to all of the frames.

    Palettes were fitted to the color of all real frames of a class; here by their geometric means
    of red to green and of green to blue.
    """
    logs = np.log([linear_from_srgb(image)[valid].mean(axis=0) for image in real])
    ratios = logs[:, [0, 2]] - logs[:, [1]]
    red, blue = np.exp(ratios[::2].mean(axis=0) - ratios.mean(axis=0))
    return np.array([red, 1.0, blue])


def by_channel(name: str, sets: dict[str, list[Measured]]) -> list[tuple[str, ...]]:
    """Plain values of each set: means, spreads and mean gradients by channel, highlights."""
    rows = []
    for side, images in sets.items():
        colors = [image.color for image in images]
        steps = (np.arange(colors[0].gradients.shape[1]) + 0.5) * 0.25
        values = [
            np.mean([color.mean for color in colors], axis=0),
            np.std([color.mean for color in colors], axis=0),
            np.mean([color.spread for color in colors], axis=0),
            np.mean([color.gradients @ steps for color in colors], axis=0),
        ]
        cells = [" / ".join(f"{x:.1f}" for x in value) for value in values]
        fraction = np.mean([image.fraction for image in images])
        spots = np.mean([image.spots for image in images])
        rows.append((name, side, str(len(images)), *cells, f"{fraction:.2f} % / {spots:.0f}"))
    return rows
