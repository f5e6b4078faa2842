"""Claim: frames look more like real ones than those of VR-Caps do.

Sets our frames of each class beside the real frames of that class, and the synthetic frames
published with VR-Caps beside the same: means, spreads and gradients in CIE L*a*b*.

    python benchmarks/validate_looks.py
    python benchmarks/validate_looks.py --only clean_colon --sheets /tmp/looks   # while tuning

With `--sheets` it writes a picture for each class that mixes both, to look at.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from looks_images import SIZE, disc, read_disc, stored, valid_pixels
from looks_scenes import exposed, shots
from PIL import Image
from validation import ROOT, table, write_section

from vrcaps import _core
from vrcaps.metrics.color import ImageColor, color_distance, image_color, linear_from_srgb

DATA = ROOT.parent / "shared" / "data"
PAGE = ROOT / "docs" / "gallery.md"
PATIENTS_AND_FRAMES = {
    "clean_colon": (2, 20),
    "capsule_non_bleeding": (2, 20),
    "capsule_bleeding": (2, 4),
    "polyp": (2, 6),
    "colitis_grade_1": (2, 12),
    "colitis_grade_2": (2, 12),
    "colitis_grade_3": (2, 12),
}
MEAN_LUMINANCE = {True: 0.20, False: 0.15}
"""Linear luminance that an automatic exposure aims at, of colonoscopes and of capsules: the mean
of the real frames."""
EXPOSURE_SPREAD = 0.25
"""Deviation of its logarithm from frame to frame; 0.19 to 0.59 in the classes of real frames."""
WHITE_SPREAD = np.array([0.12, 0.0, 0.20])
"""Deviation of the logarithm of red, green and blue gain from frame to frame: real frames come
from many makers' cameras. Over classes the ratios of mean red and blue to green deviate by 0.12 to
0.48 and 0.06 to 0.55, medians 0.18 and 0.27; this is what patients do not account for."""
GLARE = 0.03
"""Light scattered in the lens over the whole view, as a share of its mean: not
measured, chosen of 0, 3, 6 and 10 % by the distances below."""
JPEG_QUALITY = {"clean_colon": 94, "polyp": 75, "colitis": 75}
"""Of the real files, by how their class begins, all with colours at half resolution; capsule
frames are PNG files."""
RESAMPLES = 1000
STATISTICS = ("mean", "spread", "gradient")


def is_colonoscopy(name: str) -> bool:
    """Whether a class of real frames was taken by colonoscopes."""
    return not name.startswith("capsule")


def has_overlays(name: str) -> bool:
    """Whether its frames come from HyperKvasir, whose recorders print text and boxes."""
    return name.startswith(("polyp", "colitis"))


def our_discs(name: str, patients: int, frames: int) -> list[np.ndarray]:
    """Our frames of a class, as sRGB discs."""
    return finished(name, (shot.radiance for shot in shots(name, patients, frames)))


def finished(name: str, radiances: Iterable[np.ndarray]) -> list[np.ndarray]:
    """Linear frames of a class as sRGB discs, as a camera and its recorder would leave them."""
    rng = np.random.default_rng(11)
    aim = MEAN_LUMINANCE[is_colonoscopy(name)]
    quality = JPEG_QUALITY.get(name.partition("_grade")[0])
    discs = []
    for radiance in radiances:
        light = aim * np.exp(EXPOSURE_SPREAD * rng.normal())
        gains = np.exp(WHITE_SPREAD * rng.normal(size=3))
        image = exposed(veiled(radiance) * gains, light)
        discs.append(disc(stored(image, quality)))
    return discs


def veiled(radiance: np.ndarray) -> np.ndarray:
    """Radiance with veiling glare; none where the lens sees nothing."""
    seen = radiance.any(axis=-1)
    # A few mirror images of the lights would outshine all else.
    bounded = np.minimum(radiance[seen], 4.0 * radiance[seen].mean(axis=0))
    return (radiance + GLARE * bounded.mean(axis=0) * seen[..., None]).astype(np.float32)


def kept_discs(name: str, folder: Path | None) -> list[np.ndarray]:
    """Our frames of a class, from a folder if an earlier run has kept them there."""
    if folder is None:
        return our_discs(name, *PATIENTS_AND_FRAMES[name])
    path = folder / f"{name}.npy"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        np.save(path, np.stack(our_discs(name, *PATIENTS_AND_FRAMES[name])))
    return list(np.load(path))


def read_folder(paths: list[Path]) -> list[np.ndarray]:
    """Image files as discs, in the order of their names."""
    return [read_disc(path) for path in sorted(paths)]


def totals(ours: list[ImageColor], real: list[ImageColor]) -> np.ndarray:
    """Distance in each statistic: the root of the sum of squares over L*, a*, b*."""
    found = color_distance(ours, real)
    return np.array([np.linalg.norm(getattr(found, name)) for name in STATISTICS])


def bootstrap(
    ours: list[ImageColor], theirs: list[ImageColor], real: list[ImageColor]
) -> np.ndarray:
    """Distances [resample, side, statistic] when the images of each set are drawn anew."""
    rng = np.random.default_rng(3)

    def drawn(images: list[ImageColor]) -> list[ImageColor]:
        return [images[k] for k in rng.integers(len(images), size=len(images))]

    found = []
    for _ in range(RESAMPLES):
        anew = drawn(real)
        found.append([totals(drawn(ours), anew), totals(drawn(theirs), anew)])
    return np.array(found)


def compare(name: str, discs: dict[str, list[np.ndarray]]) -> tuple[list, list]:
    """Rows of the main table and of the table by channel.

    The tuning half is the even real frames, held out are the odd ones.
    """
    valid = valid_pixels(has_overlays(name))
    colors = {
        side: [image_color(image, valid) for image in images] for side, images in discs.items()
    }
    ours, theirs, real = (colors[side] for side in ("ours", "VR-Caps", "real"))
    blind = [image_color(image, valid) for image in refitted(discs["ours"], discs["real"], valid)]
    found = np.array([totals(ours, real), totals(theirs, real)])
    held_out = np.array([totals(blind, real[1::2]), totals(theirs, real[1::2])])
    drawn = bootstrap(blind, theirs, real[1::2])
    low, high = np.quantile(drawn, (0.05, 0.95), axis=0)
    wins = (drawn[:, 0] < drawn[:, 1]).mean(axis=0)
    rows = []
    for k, statistic in enumerate(STATISTICS):
        cells = [
            f"{held_out[side, k]:.2f} ({low[side, k]:.2f}–{high[side, k]:.2f})" for side in (0, 1)
        ]
        closer = ["yes" if x[0, k] < x[1, k] else "**no**" for x in (found, held_out)]
        rows.append(
            (
                *(f"{name} ({len(real[::2])} + {len(real[1::2])})", statistic),
                *(f"{found[0, k]:.2f} / {found[1, k]:.2f}", *cells, f"{100 * wins[k]:.0f} %"),
                " / ".join(closer),
            )
        )
    return rows, by_channel(name, ours, theirs, real)


def refitted(ours: list[np.ndarray], real: list[np.ndarray], valid: np.ndarray) -> list[np.ndarray]:
    """Our frames as if palettes had been fitted to the tuning half of the real ones alone.

    See `refitted_gains`.
    """
    gains = refitted_gains(real, valid)
    return [
        _core.encode_srgb((linear_from_srgb(image) * gains).astype(np.float32), 1.0)
        for image in ours
    ]


def refitted_gains(real: list[np.ndarray], valid: np.ndarray) -> np.ndarray:
    """Gains of red, green and blue by which a palette changes when half of the frames is left out.

    Palettes were fitted to the geometric means of red to green and green to blue over all real
    frames of a class.
    """
    logs = np.log([linear_from_srgb(image)[valid].mean(axis=0) for image in real])
    ratios = logs[:, [0, 2]] - logs[:, [1]]
    red, blue = np.exp(ratios[::2].mean(axis=0) - ratios.mean(axis=0))
    return np.array([red, 1.0, blue])


def by_channel(
    name: str, ours: list[ImageColor], theirs: list[ImageColor], real: list[ImageColor]
) -> list[tuple[str, ...]]:
    """Plain values: mean, spread, mean gradient of each set, and distances, by channel."""
    sides = {"real": real, "ours": ours, "VR-Caps": theirs}
    rows = []
    for side, images in sides.items():
        steps = (np.arange(images[0].gradients.shape[1]) + 0.5) * 0.25
        values = [
            np.mean([image.mean for image in images], axis=0),
            np.std([image.mean for image in images], axis=0),
            np.mean([image.spread for image in images], axis=0),
            np.mean([image.gradients @ steps for image in images], axis=0),
        ]
        cells = [" / ".join(f"{x:.1f}" for x in value) for value in values]
        rows.append((name, side, str(len(images)), *cells))
    return rows


def write_sheet(path: Path, discs: dict[str, list[np.ndarray]]) -> None:
    """Two rows of ours over one of real frames."""
    inside = valid_pixels(False)[..., None]
    ours, real = discs["ours"], discs["real"]
    chosen = [ours[k] for k in np.linspace(0, len(ours) - 1, 24).astype(int)]
    tiles = [*chosen, *real[:12], *[np.zeros((SIZE, SIZE, 3), np.uint8)] * (12 - len(real[:12]))]
    rows = [np.hstack([tile * inside for tile in tiles[k : k + 12]]) for k in (0, 12, 24)]
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.vstack(rows)).save(path)


def main() -> None:
    """Render, compare, write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=list(PATIENTS_AND_FRAMES), help="classes")
    parser.add_argument("--sheets", type=Path, help="folder for pictures that mix ours and real")
    parser.add_argument("--keep", type=Path, help="folder that keeps our frames between runs")
    parser.add_argument("--out", type=Path, help="Markdown page to write into")
    given = parser.parse_args()
    theirs = read_folder(list((DATA / "reference_frames").glob("synthetic_*")))
    rows, channels, changes = [], [], []
    for name in given.only:
        discs = {
            "ours": kept_discs(name, given.keep),
            "VR-Caps": theirs,
            "real": read_folder(list((DATA / "real_frames" / name).iterdir())),
        }
        if given.sheets:
            write_sheet(given.sheets / f"{name}.png", discs)
        gains = refitted_gains(discs["real"], valid_pixels(has_overlays(name)))
        changes.append(100.0 * np.abs(gains - 1.0).max())
        new_rows, new_channels = compare(name, discs)
        rows += new_rows
        channels += new_channels
        print(*new_rows, *new_channels, sep="\n", flush=True)
    if given.out:
        write_section(given.out, Path(__file__).name, report(rows, channels, changes))


HEAD = (
    *("real class (tuning + held out)", "statistic", "all: ours / VR-Caps"),
    *("held out: ours", "held out: VR-Caps", "resamples of it in which ours is closer"),
    "ours closer: all / held out",
)
HEAD_CHANNELS = (
    *("class", "frames of", "number", "mean L / a / b", "deviation of means"),
    *("spread within a frame", "mean gradient"),
)


TEXT = r"""## Colour, beside real frames

`python benchmarks/validate_looks.py --out docs/gallery.md`: our frames beside real ones of seven
classes (human capsule frames of WCEBleedGen, colonoscopies of EndoAngel and HyperKvasir), and the
three synthetic frames published with VR-Caps beside the same, in CIE L\*a\*b\*. Distances are in
its units, root of the sum of squares over the three channels; smaller is more alike.

- *mean*, *spread*: Wasserstein-1 distance between the frames' means, and between their standard
  deviations. *gradient*: the same distance between the pooled histograms of the gradient's
  magnitude. A set of frames that are all alike is therefore far from a varied one.
- *Held out*: every second real frame, by name. What saw which half:
  - Palettes were fitted to class means of R/G and G/B over all frames; for the held-out columns
    our frames get the gains that leaving its half out of those means makes, by
    {least:.0f} to {most:.0f} % in red or blue, whichever is more, over the classes.
  - The spread of white balance and the colour of blood were fitted to the tuning half.
  - Granules, vessels and relief of colitis were chosen by gradients of the tuning half: three
    settings of grade 1 were tried and the best kept, and two of grade 2. Bile, contrasts, pits
    and glare were chosen by distances from all frames. Tables of all frames were in sight
    throughout, and every picture was looked at: held out is not unseen.
- In brackets, 5th and 95th percentile of 1,000 resamples of the frames of all sets; next, in how
  many of them ours is closer. Sets are small, so the resampled distances are larger than the
  measured ones.
- One scale: each frame becomes a disc {size} pixels wide, 0.9 of the shorter side of its field of
  view, so black borders and what is printed on them do not count. Where recorders print text and
  boxes into the view (HyperKvasir), the left sixth, and two fifths of the lowest third, are left
  out in all three sets.
- One way of storing: where the real frames are JPEG files, ours are stored at their size, quality
  and colour resolution first. Those of VR-Caps are crops of published figures, taken as they are.
- Ours: capsule classes by the catalog's PillCam SB3 in small bowels; the others by a colonoscope's
  tip with a field of 140° and two light guides in colons. Flights are even along the lumen and
  sway by up to 45°; lesions are looked at. Exposure follows the mean luminance of the real frames,
  as automatic exposure does, with a deviation of 0.25 in its logarithm. Red and blue gain deviate
  by {red:.2f} and {blue:.2f} in theirs, since real frames come from many cameras; the lens scatters
  {glare:.0%} of the light over the view.

What is not in ours: bubbles, stool, instruments, sensor noise, and light that the wall throws back
on itself.
"""


def report(rows: list, channels: list, changes: list[float]) -> str:
    """The section of the page; `changes` of palettes by the tuning half alone, by class [%]."""
    text = TEXT.format(
        **{"size": SIZE, "red": WHITE_SPREAD[0], "blue": WHITE_SPREAD[2], "glare": GLARE},
        **{"least": min(changes), "most": max(changes)},
    )
    return f"{text}\n{table(HEAD, rows)}\n\nBehind it:\n\n{table(HEAD_CHANNELS, channels)}\n"


if __name__ == "__main__":
    main()
