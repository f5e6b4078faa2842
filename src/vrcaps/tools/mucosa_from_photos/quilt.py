"""Image quilting on a torus: a large seamless texture from small patches, and its quality.

Efros A. A., Freeman W. T. Image quilting for texture synthesis and transfer. SIGGRAPH 2001.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.color import lab_from_srgb
from vrcaps.core.processes import ProgressReport, no_report
from vrcaps.tools.photos import highlights

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int, UInt8

_TOLERANCE = 0.15  # maximum relative excess of a patch's error over the least
_TRIED = 4  # sources searched for each patch
_REUSE = 0.6  # relative penalty of a position for each earlier use
_MAX_USED = 4.0  # maximum number of uses counted
_MASKED = 3.0  # penalty of a patch entirely of filled-in pixels [median differences]
_FEATHER = 1.0  # standard deviation of the seam's blur [px]
_BINS = np.linspace(0.0, 30.0, 61)  # bins of gradients in L* per texel
_SIDES = ("left", "top", "right", "bottom")


@dataclass(frozen=True)
class Quilt:
    """Layout of the patches.

    Attributes:
        patch: Side of a patch [px].
        overlap: Minimum overlap of neighboring patches [px].
    """

    patch: int
    overlap: int

    @classmethod
    def of_side(cls, side: int) -> Quilt:
        """Patches of two fifths of a source's side, 16 to 128 px, with an overlap of a quarter."""
        patch = int(np.clip(round(0.4 * side), 16, 128))
        return cls(patch, patch // 4)


def variants(squares: list[np.ndarray]) -> list[np.ndarray]:
    """Rotate each square by 0, 90, 180, 270° and mirror it: mucosa has no orientation."""
    return [
        turned
        for square in squares
        for turn in range(4)
        for turned in (np.rot90(square, turn), np.rot90(square, turn)[:, ::-1])
    ]


def quilt(
    sources: list[Float[np.ndarray, "s s c"]],
    doubtful: list[Bool[np.ndarray, "s s"]],
    size: int,
    layout: Quilt,
    rng: np.random.Generator,
    *,
    progress: ProgressReport = no_report,
) -> Float[np.ndarray, "size size c"]:
    """Synthesize a tileable texture of size × size.

    Patches are placed row by row. Each is chosen at random among positions in some sources whose
    sum of squared differences over the overlap is close to the minimum; reused positions and
    filled-in pixels are penalized. It is joined along the minimum-error path.

    Args:
        sources: Squares to take patches from, all of one side; see `variants`.
        doubtful: Masks of the filled-in pixels of each source.
        size: Side of the texture [px]; at least two patches.
        layout: Size of the patches.
        rng: Random generator.
        progress: Called with the number of patches laid and their total.
    """
    starts = _starts(size, layout)
    search = _Search(sources, doubtful, layout.patch, rng)
    canvas = np.zeros((size, size, sources[0].shape[2]), np.float32)
    total = len(starts) ** 2
    for number in range(total):
        i, j = divmod(number, len(starts))
        rows, columns = (
            (start + np.arange(layout.patch)) % size for start in (starts[i], starts[j])
        )
        overlaps = _overlaps(starts, i, j, size, layout.patch)
        there = canvas[np.ix_(rows, columns)]
        patch = search.choose(there, overlaps)
        alpha = _join(there, patch, overlaps)[..., None]
        canvas[np.ix_(rows, columns)] = there + alpha * (patch - there)
        progress(number + 1, total)
    # The edges then run through the middle of patches, without joins along them.
    return np.roll(canvas, -(layout.patch // 2), axis=(0, 1))


def _starts(size: int, layout: Quilt) -> Int[np.ndarray, " n"]:
    count = max(2, -(-size // (layout.patch - layout.overlap)))
    return np.arange(count) * size // count


def _overlaps(starts, i: int, j: int, size: int, patch: int) -> tuple[int, int, int, int]:
    """Depth [px] of the placed texture at the left, top, right and bottom of patch i, j."""
    last = len(starts) - 1
    closing = int(starts[last]) + patch - size
    left = int(starts[j - 1]) + patch - int(starts[j]) if j else 0
    top = int(starts[i - 1]) + patch - int(starts[i]) if i else 0
    return left, top, closing if j == last else 0, closing if i == last else 0


class _Search:
    """Patch search in the sources, by correlation through the Fourier transform."""

    def __init__(self, sources, doubtful, patch: int, rng: np.random.Generator) -> None:
        self.sources = np.stack(sources).astype(np.float32)
        self.patch, self.rng = patch, rng
        side = self.sources.shape[1]
        self.shape = (scipy.fft.next_fast_len(side, real=True),) * 2
        self.positions = side - patch + 1
        spectrum = np.asarray(scipy.fft.rfft2(self.sources, self.shape, axes=(1, 2)))
        self.spectrum = np.ascontiguousarray(np.moveaxis(spectrum, 3, 1))
        self.energy = np.asarray(scipy.fft.rfft2((self.sources**2).sum(axis=3), self.shape))
        self.masked = np.stack([_box_mean(mask, patch) for mask in doubtful]).astype(np.float32)
        self.used = np.zeros_like(self.masked)
        self.energies = lru_cache(maxsize=64)(self._energies)

    def choose(self, there, overlaps) -> Float[np.ndarray, "p p c"]:
        """Choose a patch that fits the placed texture."""
        tried = self.rng.permutation(len(self.sources))[:_TRIED]
        mask = _band(self.patch, overlaps)
        if not mask.any():
            cost = np.ones((len(tried), self.positions, self.positions), np.float32)
        else:
            cost = self._differences(there * mask[..., None], overlaps, tried) / mask.sum()
        middle = float(np.median(cost))
        cost = cost + 1e-4 + middle * (0.02 + _MASKED * self.masked[tried])
        cost *= 1.0 + _REUSE * np.minimum(self.used[tried], _MAX_USED)
        good = np.flatnonzero(cost.ravel() <= (1.0 + _TOLERANCE) * float(cost.min()))
        chosen = good[int(self.rng.integers(len(good)))]
        k, row, column = (int(n) for n in np.unravel_index(chosen, cost.shape))
        self._mark(int(tried[k]), row, column)
        return self.sources[tried[k], row : row + self.patch, column : column + self.patch]

    def _differences(self, there, overlaps, tried) -> Float[np.ndarray, "k n n"]:
        """Sum of squared differences at every position of the given sources."""
        wanted = np.asarray(scipy.fft.rfft2(there, self.shape, axes=(0, 1)))
        product = np.einsum("kcij,ijc->kij", self.spectrum[tried], wanted.conj())
        across = np.asarray(scipy.fft.irfft2(product, self.shape))[
            :, : self.positions, : self.positions
        ]
        total = self.energies(overlaps)[tried] - 2.0 * across + (there**2).sum()
        return np.maximum(total, 0.0)

    def _energies(self, overlaps) -> Float[np.ndarray, "k n n"]:
        band = _band(self.patch, overlaps).astype(np.float32)
        mask = np.asarray(scipy.fft.rfft2(band, self.shape))
        sums = np.asarray(scipy.fft.irfft2(self.energy * mask.conj(), self.shape))
        return sums[:, : self.positions, : self.positions]

    def _mark(self, source: int, row: int, column: int) -> None:
        """Mark a position and its neighbors as used, in every rotation of the same square."""
        reach = max(2, self.patch // 4)
        first = source // 8 * 8
        family = np.arange(first, min(first + 8, len(self.sources)))
        weight = np.full(len(family), 0.25, np.float32)
        weight[source - first] = 1.0
        window = np.s_[max(0, row - reach) : row + reach, max(0, column - reach) : column + reach]
        for member, part in zip(family, weight, strict=True):
            self.used[member][window] += part


def _box_mean(mask: np.ndarray, side: int) -> Float[np.ndarray, "n n"]:
    total = np.pad(mask.astype(np.float64), ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
    box = total[side:, side:] - total[:-side, side:] - total[side:, :-side] + total[:-side, :-side]
    return box / side**2


@lru_cache(maxsize=64)
def _band(patch: int, overlaps: tuple[int, int, int, int]) -> Bool[np.ndarray, "p p"]:
    """Mask of a patch's overlap with the placed texture."""
    left, top, right, bottom = overlaps
    band = np.zeros((patch, patch), bool)
    band[:, :left] = band[:top] = band[:, patch - right :] = band[patch - bottom :] = True
    return band


def _join(there, patch, overlaps) -> Float[np.ndarray, "p p"]:
    """Weight of the new patch: 0 outside the seams, 1 inside, blurred by about a pixel."""
    difference = ((there - patch) ** 2).sum(axis=2)
    alpha = np.ones(difference.shape, np.float32)
    for turns, depth in enumerate(overlaps):
        if depth:
            # Rotated so that the overlap lies left: top, right, bottom in order.
            turned = np.rot90(difference, turns)[:, :depth]
            keep = np.ones(difference.shape, np.float32)
            keep[:, :depth] = np.arange(depth) > least_path(turned)[:, None]
            alpha = np.minimum(alpha, np.rot90(keep, -turns))
    soft = scipy.ndimage.gaussian_filter(alpha, _FEATHER, mode="nearest")
    return np.where(_rim(alpha.shape[0], overlaps), alpha, soft)


@lru_cache(maxsize=64)
def _rim(patch: int, overlaps: tuple[int, int, int, int]) -> Bool[np.ndarray, "p p"]:
    """Mask of the outermost pixels of the overlaps, which do not change."""
    return _band(patch, tuple(min(depth, 2) for depth in overlaps))  # type: ignore[arg-type]


def least_path(cost: Float[np.ndarray, "n w"]) -> Int[np.ndarray, " n"]:
    """Column in each row of the path of least total cost from top to bottom.

    The column changes by at most one from row to row (Efros & Freeman 2001, section 2.1).
    """
    height, width = cost.shape
    total = np.full((height, width + 2), np.inf)
    total[0, 1:-1] = cost[0]
    for row in range(1, height):
        above = total[row - 1]
        total[row, 1:-1] = cost[row] + np.minimum(np.minimum(above[:-2], above[1:-1]), above[2:])
    path = np.empty(height, np.int64)
    path[-1] = np.argmin(total[-1])
    for row in range(height - 2, -1, -1):
        near = path[row + 1]
        path[row] = near - 1 + np.argmin(total[row, near - 1 : near + 2])
    return path - 1


@dataclass(frozen=True)
class TextureQuality:
    """Comparison of a texture with its source regions.

    Attributes:
        seam_ratio: Mean step across the wrapped edges over that inside.
        lab_mean_source: Mean L*, a*, b* of the regions.
        lab_mean_texture: Mean L*, a*, b* of the texture.
        lab_std_source: Standard deviation of L*, a*, b* of the regions.
        lab_std_texture: Standard deviation of L*, a*, b* of the texture.
        gradient_distance: Difference of the histograms of steps in L* between neighbors: half
            the sum of absolute differences, 0 (same) to 1.
        repetition: Highest autocorrelation of L* beyond the reach of a patch, 0 to 1; a repeated
            texture has 1.
        highlight_fraction: Fraction of the texels detected as highlights.
    """

    seam_ratio: float
    lab_mean_source: tuple[float, ...]
    lab_mean_texture: tuple[float, ...]
    lab_std_source: tuple[float, ...]
    lab_std_texture: tuple[float, ...]
    gradient_distance: float
    repetition: float
    highlight_fraction: float

    def record(self) -> dict:
        """Convert to plain values, rounded."""
        return {
            name: [round(v, 2) for v in value] if isinstance(value, tuple) else round(value, 5)
            for name, value in asdict(self).items()
        }


def texture_quality(
    texture: UInt8[np.ndarray, "n n 3"], sources: list[UInt8[np.ndarray, "s s 3"]]
) -> TextureQuality:
    """Compare a texture, before vessels are placed, with its sources."""
    colors = lab_from_srgb(texture)
    regions = [lab_from_srgb(source) for source in sources]
    pixels = np.concatenate([region.reshape(-1, 3) for region in regions])
    flat = colors.reshape(-1, 3)
    everywhere = np.ones(texture.shape[:2], bool)
    return TextureQuality(
        seam_ratio=seam_ratio(colors),
        lab_mean_source=_plain(pixels.mean(axis=0)),
        lab_mean_texture=_plain(flat.mean(axis=0)),
        lab_std_source=_plain(pixels.std(axis=0)),
        lab_std_texture=_plain(flat.std(axis=0)),
        gradient_distance=_gradient_distance(colors, regions),
        repetition=repetition(colors[..., 0], reach=len(sources[0])),
        highlight_fraction=float(highlights(texture, everywhere, len(texture)).mean()),
    )


def seam_ratio(image: Float[np.ndarray, "n m c"]) -> float:
    """Mean absolute step across the two wrapped edges over that between inner neighbors."""
    seams, inner = [], []
    for axis in (0, 1):
        step = np.diff(image, axis=axis, append=np.take(image, [0], axis=axis))
        seams.append(np.take(step, [-1], axis=axis).ravel())
        inner.append(np.delete(step, -1, axis=axis).ravel())
    seam, inside = (float(np.abs(np.concatenate(part)).mean()) for part in (seams, inner))
    return seam / inside if inside > 0.0 else 1.0


def repetition(image: Float[np.ndarray, "n n"], *, reach: int) -> float:
    """Highest autocorrelation at shifts longer than `reach` [px], without slow variation.

    Computed by the Wiener-Khinchin theorem with periodic boundaries.
    """
    power = np.abs(np.fft.rfft2(image - image.mean())) ** 2
    rows, columns = np.fft.fftfreq(len(image)), np.fft.rfftfreq(len(image))
    power[np.hypot(rows[:, None], columns[None]) < 0.5 / reach] = 0.0
    correlation = np.fft.irfft2(power, image.shape)
    shift = np.abs(np.fft.fftfreq(len(image), 1.0 / len(image)))
    far = np.hypot(shift[:, None], shift[None]) > reach
    if not far.any() or correlation[0, 0] <= 0.0:
        return 0.0
    return float(correlation[far].max() / correlation[0, 0])


def _gradient_distance(texture, regions) -> float:
    def histogram(images) -> np.ndarray:
        steps = [
            np.abs(np.diff(image[..., 0], axis=axis)).ravel() for image in images for axis in (0, 1)
        ]
        counts, _ = np.histogram(np.concatenate(steps), _BINS)
        return counts / counts.sum()

    return float(0.5 * np.abs(histogram([texture]) - histogram(regions)).sum())


def _plain(values: np.ndarray) -> tuple[float, ...]:
    return tuple(float(value) for value in values)
