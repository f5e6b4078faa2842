"""Claim: simulated frames are closer to real ones than those of VR-Caps.

Compares simulated frames of each class, and the synthetic frames published with VR-Caps, with real
frames of that class: means, spreads and gradients in CIE L*a*b*, and highlights.

    python -m benchmarks.appearance.compare
    python -m benchmarks.appearance.compare --only clean_colon --sheets /tmp/looks   # while tuning
    python -m benchmarks.appearance.compare --mixed /tmp/mixed.png                  # mixed sheet

With `--sheets` it writes a picture for each class that shows both, with `--mixed` one of ours and
real ones shuffled, with the key in a text file.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from benchmarks.appearance.camera import WHITE_SPREAD, our_discs
from benchmarks.appearance.images import SIZE, read_disc, valid_pixels
from benchmarks.appearance.scenes import scenes, shots
from benchmarks.appearance.statistics import compare, refitted_gains
from benchmarks.common.scripts import ROOT, table, write_section

DATA = ROOT.parent / "shared" / "data"
PAGE = ROOT / "docs" / "reference" / "gallery.md"
PATIENTS_AND_FRAMES = {
    "clean_colon": (2, 20),
    "capsule_non_bleeding": (2, 20),
    "capsule_bleeding": (2, 4),
    "polyp": (2, 6),
    "colitis_grade_1": (2, 12),
    "colitis_grade_2": (2, 12),
    "colitis_grade_3": (2, 12),
}

RED = (0.25, 0.55)
"""Allowed reflectance in red. A deep tissue with the scattering of colon (Marchesini et al. 1994)
and 0.5 to 5 % of blood (150 g/l; Prahl's table) gives back 0.40 to 0.25 at 620 nm by diffusion
(`vrcaps.render.imaging.diffuse_reflectance`); above it for light collected from other places of
the wall and the gains of endoscopes' red."""
MIXED = 24
"""Frames of ours in the mixed picture, about, and as many real ones."""


def has_overlays(name: str) -> bool:
    """Return whether its frames come from HyperKvasir, whose recorders print text and boxes."""
    return name.startswith(("polyp", "colitis"))


def kept_discs(name: str, folder: Path | None) -> list[np.ndarray]:
    """Simulated frames of a class, read from a folder if an earlier run stored them there."""
    path = None if folder is None else folder / f"{name}.npy"
    if path is not None and path.exists():
        return list(np.load(path))
    made = our_discs(name, shots(scenes(name, *PATIENTS_AND_FRAMES[name])))
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, np.stack(made))
    return made


def read_folder(paths: list[Path]) -> list[np.ndarray]:
    """Image files as discs, in the order of their names."""
    return [read_disc(path) for path in sorted(paths)]


def write_sheet(path: Path, discs: dict[str, list[np.ndarray]]) -> None:
    """Two rows of simulated frames above one of real frames."""
    inside = valid_pixels(False)[..., None]
    ours, real = discs["ours"], discs["real"]
    chosen = [ours[k] for k in np.linspace(0, len(ours) - 1, 24).astype(int)]
    tiles = [*chosen, *real[:12], *[np.zeros((SIZE, SIZE, 3), np.uint8)] * (12 - len(real[:12]))]
    rows = [np.hstack([tile * inside for tile in tiles[k : k + 12]]) for k in (0, 12, 24)]
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.vstack(rows)).save(path)


def write_mixed(path: Path, sets: dict[str, dict[str, list[np.ndarray]]]) -> None:
    """Equal numbers of simulated and real frames of the same classes, shuffled and numbered.

    A text file of the same name states which are simulated. Frames of
    HyperKvasir lose where their recorders print, and ours the same.
    """
    rng, tiles = np.random.default_rng(), []
    for name, discs in sets.items():
        valid = valid_pixels(has_overlays(name))[..., None]
        each = min(MIXED // len(sets), len(discs["real"]), len(discs["ours"]))
        for side in ("ours", "real"):
            chosen = rng.permutation(len(discs[side]))[:each]
            tiles += [(f"{side}, {name}", discs[side][k] * valid) for k in chosen]
    order = rng.permutation(len(tiles))
    columns = int(np.ceil(1.5 * len(tiles) ** 0.5))
    picture = Image.new("RGB", (columns * SIZE, -(-len(tiles) // columns) * (SIZE + 14)))
    draw = ImageDraw.Draw(picture)
    for place, k in enumerate(order):
        x, y = place % columns * SIZE, place // columns * (SIZE + 14)
        picture.paste(Image.fromarray(tiles[k][1]), (x, y))
        draw.text((x + 2, y + SIZE), str(place + 1), fill=(225, 225, 225))
    picture.save(path)
    key = [f"{place + 1}: {tiles[k][0]}" for place, k in enumerate(order)]
    path.with_suffix(".txt").write_text("\n".join(key) + "\n", encoding="utf-8")


def main() -> None:
    """Render, compare, write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=list(PATIENTS_AND_FRAMES), help="classes")
    parser.add_argument("--sheets", type=Path, help="folder for pictures that mix ours and real")
    parser.add_argument(
        "--mixed", type=Path, help="picture to write, shuffled and numbered; key beside"
    )
    parser.add_argument("--keep", type=Path, help="folder that keeps our frames between runs")
    parser.add_argument(
        "--before", type=Path, help="folder that an earlier version's --keep filled"
    )
    parser.add_argument("--out", type=Path, help="Markdown page to write into")
    given = parser.parse_args()
    theirs = read_folder(list((DATA / "reference_frames").glob("synthetic_*")))
    rows, channels, changes, sets = [], [], [], {}
    for name in given.only:
        valid = valid_pixels(has_overlays(name))
        discs = {
            "real": read_folder(list((DATA / "real_frames" / name).iterdir())),
            "ours": kept_discs(name, given.keep),
            "VR-Caps": theirs,
        }
        if given.before:
            discs["before"] = list(np.load(given.before / f"{name}.npy"))
        sets[name] = discs
        if given.sheets:
            write_sheet(given.sheets / f"{name}.png", discs)
        gains = refitted_gains(discs["real"], valid)
        changes.append(100.0 * np.abs(gains - 1.0).max())
        new_rows, new_channels = compare(name, discs, valid)
        rows += new_rows
        channels += new_channels
        print(*new_rows, *new_channels, sep="\n", flush=True)
    if given.mixed:
        write_mixed(given.mixed, sets)
    if given.out:
        write_section(given.out, Path(__file__), report(rows, channels, changes))


HEAD = (
    *("real class (tuning + held out)", "statistic", "all: before", "all: ours", "all: VR-Caps"),
    *("held out: ours", "held out: VR-Caps", "resamples of it in which ours is closer"),
    "ours closer: all / held out",
)
HEAD_CHANNELS = (
    *("class", "frames of", "number", "mean L / a / b", "deviation of means"),
    *("spread within a frame", "mean gradient", "highlights, fraction / number"),
)


TEXT = r"""## Color, gradients and highlights compared with real frames

`python -m benchmarks.appearance.compare --out docs/reference/gallery.md`: our frames beside real
ones of seven classes (human capsule frames of WCEBleedGen, colonoscopies of EndoAngel and
HyperKvasir), and the three synthetic frames published with VR-Caps next to the same. Color is CIE
L\*a\*b\*: distances are in its units, root of the sum of squares over the three channels; smaller
is more alike.

- *mean*, *spread*: Wasserstein-1 distance between the frames' means, and between their standard
  deviations. *gradient*: the same distance between the pooled histograms of the gradient's
  magnitude. *highlights*: the same between the fractions of the view that are highlights, in
  percent (`vrcaps.metrics.images.highlights`). A set of frames that are all alike is therefore far
  from a varied one.
- *before*: direct light, a palette fitted to it, and a veil and white balance in place of lens and
  sensor: frames that commit c4bc116 kept with `--keep FOLDER`, given here by `--before FOLDER`.
- *Ours*: radiosity with shadows; palettes by `python -m benchmarks.appearance.fit`,
  which finds the base colors at which the frames' mean a\*, mean b\* and spread of L\* are those
  of the real ones. Red stays within {red_low} and {red_high}: a deep tissue with the scattering of
  colon and 0.5 to 5 % of blood gives back 0.40 to 0.25 of it by diffusion.
- *Held out*: every second real frame, by name. What saw which half:
  - Palettes were fitted to class means over all frames; for the held-out columns our frames get
    the gains that leaving its half out of those means makes, by {least:.0f} to {most:.0f} % in red
    or blue, whichever is more, over the classes.
  - The spread of white balance and the color of blood were fitted to the tuning half.
  - Granules, vessels and relief of colitis were chosen by gradients of the tuning half: three
    settings of grade 1 were tried and the best kept, and two of grade 2. Stain, mucus, patches of
    blood, mucopus, contrasts, pits, the colon's clear coat and severities of noise were chosen by
    distances from all frames. Tables of all frames were in sight throughout, and every picture was
    looked at: held out is not unseen.
- In brackets, 5th and 95th percentile of 1,000 resamples of the frames of all sets; next, in how
  many of them ours is closer. Sets are small, so the resampled distances are larger than the
  measured ones.
- One scale: each frame becomes a disc {size} pixels wide, 0.9 of the shorter side of its field of
  view, so black borders and text printed on them do not count. Where recorders print text and
  boxes into the view (HyperKvasir), the left sixth, and two fifths of the lowest third, are left
  out in all three sets.
- Where the real frames are JPEG files, ours are stored at their size, quality and color resolution
  first. Those of VR-Caps are crops of published images, taken as they are.
- Capsule classes are seen by the catalog's PillCam SB3 in small bowels: those without bleeding in
  collapsed ones, every second frame with bubbles, chyme and liquid. The others are seen by a
  colonoscope's tip with a field of 140° and two light guides in colons that hold what scores 3 and
  2 of the Boston scale leave, in turn. Flights are even along the lumen and sway by up to 45°;
  lesions are looked at.
- Lens and sensor are the stages of [effects](../concepts/effects.md), their severities sampled for
  each frame (`benchmarks/appearance/camera.py`): vignette, bloom, lateral color, noise; in capsules
  defocus and mosaic. Exposure follows the mean luminance of the real frames, as automatic exposure
  does, with a deviation of 0.25 in its logarithm; red and blue gain deviate by {red:.2f} and
  {blue:.2f} in theirs, since real frames come from many cameras.

What gives ours away: of 42 frames in a sheet of `--mixed FOLDER/mixed.png` one who knows both named
all 42 rightly (41 before mucus, stain and stool), by shape: our lumen is a regular tube, triangular
or star-shaped, with folds in ranks one behind the other; real ones are pillowy, with dark clefts,
and often so near that no lumen is seen. Highlights of ours are many and evenly strewn where real
ones are few, hard and in clusters; streaks of blood lie on the wall like ribbons. What no frame of
ours has: instruments, motion, sheets of froth, overexposed rims. Real video is sharpened. Within a
frame of a colon a\* and b\* of real ones spread by 9 to 13 and 8 to 10 units, of ours by 9 to 12
and 7 to 8 (before mucus and stain, by 7 to 10 and 6 to 8). With radiosity none spreads inside the
wall.
"""


def report(rows: list, channels: list, changes: list[float]) -> str:
    """Section of the page; `changes` [%] are of palettes of the tuning half alone, by class."""
    text = TEXT.format(
        **{"size": SIZE, "red": WHITE_SPREAD[0], "blue": WHITE_SPREAD[2]},
        **{"least": min(changes), "most": max(changes), "red_low": RED[0], "red_high": RED[1]},
    )
    return f"{text}\n{table(HEAD, rows)}\n\nBehind it:\n\n{table(HEAD_CHANNELS, channels)}\n"


if __name__ == "__main__":
    main()
