"""Claim: default images are nearer to real capsule images than those of other simulators.

Patients are recorded by `vrcaps record` with default settings, half of the frames along the lumen
and half at random, and compared with real capsule images as `vrcaps compare-looks` does. Trivial
baselines are the two halves of the real set, split at random, and the mean real image repeated.

    python -m benchmarks.appearance.distance
    python -m benchmarks.appearance.distance --patients 1 --work /tmp/looks    # while tuning
    python -m benchmarks.appearance.distance --ablations                       # all parts
    python -m benchmarks.appearance.distance --ablations 'no image chain'

Recordings stay in `--work`, so that an interrupted run resumes; those of another version of the
package must be deleted first.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import ROOT, parser, table, write_section
from vrcaps.formats import read_source
from vrcaps.recording.frame_sequence import FrameSequence
from vrcaps.tools.appearance.compare import (
    Comparison,
    DescribedSet,
    compare,
    describe,
    halves,
    without_duplicates,
)
from vrcaps.tools.appearance.views import ImageSet, read_image_set

REAL = ROOT.parent / "shared" / "data" / "real"
CAPSULE_IMAGES = tuple(f"wce_bleedgen/{part}/non_bleeding" for part in ("train", "val"))
"""Reference: human small-bowel capsule images of WCEBleedGen."""
PEERS = {"VR-Caps, stomach (UnityCam)": "unitycam_stomach/Frames"}
"""Images published with other simulators."""
RECORDERS_APART = 0.19
"""Pooled KID of the reference to WCEBleedGen test 2 (302 images of 23 patients), measured once with
the same protocol. It is the unit of R."""
PAGE = ROOT / "docs" / "results" / "appearance.md"
TITLE = "# Distance to real images\n"

CAPSULES = ("pillcam-sb3", "mirocam", "pillcam-colon2")
PATIENTS = {"small-bowel": 5, "colon": 3, "stomach": 3}
"""Number of patients of each organ; their capsules alternate."""
MOTIONS = {"fly-through": ("--whole",), "random-views": ()}
FRAMES = 16
"""Number of frames of each patient and motion."""
ABLATIONS = {
    "no image chain": ("--effects", "none,ae=settled"),
    "open lumen": ("--distension", "normal"),
    "no villi": tuple(
        word
        for name in ("organ.mucosa.pit_slope", "organ.mucosa.pit_shade", "render.villi")
        for word in ("--set", f"{name}=0")
    ),
    "no contents": tuple(
        word for kind in ("bubbles", "medium", "film") for word in ("--set", f"contents.{kind}=0")
    ),
    "no variation": ("--set", "variation=false"),
}
"""Options of `vrcaps record` that switch one part off. Without the image chain the exposure stays
automatic; without variation, contents and tilt are not drawn by prevalence."""
ABLATED = 2
"""Number of patients of the small bowel in ablations."""
COLUMNS = ("set", "images", "KID block 3", "KID block 5", "KID pooled", "R", "coverage",
    "medians outside the real 10 to 90 %")  # fmt: skip


def recorded(
    folder: Path, organ: str, patients: Iterable[int], options: Sequence[str] = ()
) -> list[FrameSequence]:
    """Record patients of an organ, unless an earlier run has, and read them."""
    found = []
    for seed in patients:
        capsule = CAPSULES[seed % len(CAPSULES)]
        for motion, more in MOTIONS.items():
            out = folder / f"{organ}-{seed}-{motion}"
            if not (out / "episode.json").exists():
                shutil.rmtree(out, ignore_errors=True)
                command = ("record", "--out", str(out), "--organ", organ, "--seed", str(seed))
                shot = ("--capsule", capsule, "--motion", motion, "--frames", str(FRAMES))
                _vrcaps((*command, *shot, "--channels", "rgb", "depth", *more, *options))
            found += [replace(one, patient=f"{organ}-{seed}") for one in read_source(str(out))]
    return found


def _vrcaps(words: Sequence[str]) -> None:
    print("vrcaps", *words, file=sys.stderr, flush=True)
    program = "from vrcaps.cli import main; main()"
    subprocess.run([sys.executable, "-c", program, *words], check=True, stdout=subprocess.DEVNULL)


def described(name: str, sequences: Sequence[FrameSequence]) -> DescribedSet:
    """Views and features of sequences."""
    return describe(read_image_set(name, sequences, max_images=400))


def reference() -> DescribedSet:
    """Real images without near-duplicates; each image is a group, since no patient is stated."""
    parts = [read_source(str(REAL / name)) for name in CAPSULE_IMAGES]
    images = [read_image_set("real", part, max_images=400) for part in parts]
    views = np.concatenate([one.views for one in images])
    names = tuple(name for one in images for name in one.names)
    whole = ImageSet("real", views, np.full(len(views), "real"), names)
    return without_duplicates(describe(whole))


def constant(real: DescribedSet) -> DescribedSet:
    """The mean real image, repeated."""
    mean = real.images.views.mean(axis=0).round().astype(np.uint8)
    count = 24
    names = tuple(f"mean/{k}" for k in range(count))
    return describe(
        ImageSet("mean real image", mean[None].repeat(count, 0), np.arange(count), names)
    )


def row(found: Comparison) -> tuple[str, ...]:
    """Row of `COLUMNS`."""
    distances = found.distances
    levels = (f"{distances[k].value:.2f} ± {distances[k].half_width:.2f}"
        for k in ("block 3", "block 5", "pooled"))  # fmt: skip
    ratio, outside = f"{found.pooled / RECORDERS_APART:.1f}", ", ".join(found.outside) or "none"
    return (found.name, str(found.count), *levels, ratio, f"{found.coverage:.2f}", outside)


def near_wall(sequences: Sequence[FrameSequence]) -> tuple[str, ...]:
    """Percentiles of depth, and fractions of frames by what they show.

    Depth is along the optical axis. The wall touches the dome within about 5 mm of the lens; a
    frame whose deepest hundredth is beyond 30 mm shows an open lumen.
    """
    frames = [one.image("depth", k) for one in sequences for k in range(len(one))]
    depths = [frame[np.isfinite(frame)] for frame in frames]
    low, middle, high = 1e3 * np.percentile(np.concatenate(depths), [10.0, 50.0, 90.0])
    near = np.mean([np.mean(one < 5e-3) > 0.25 for one in depths])
    is_open = np.mean([np.percentile(one, 99.0) > 30e-3 for one in depths])
    within = np.mean([np.mean(one < 5e-3) for one in depths])
    fractions = (f"{100 * value:.0f} %" for value in (within, near, is_open))
    return (f"{low:.1f} / {middle:.1f} / {high:.1f} mm", *fractions)


def main() -> None:
    """Record, compare, and write the page."""
    asked = parser(__doc__ or "")
    asked.set_defaults(out=PAGE)
    asked.add_argument("--work", type=Path, default=ROOT / "runs" / "looks", help="recordings")
    asked.add_argument("--patients", type=int, default=5, help="maximum number of each organ")
    asked.add_argument("--others", type=int, default=5, help="maximum number of colon and stomach")
    asked.add_argument("--ablations", nargs="*", choices=ABLATIONS, help="parts to leave out")
    given = asked.parse_args()
    real = reference()
    sets, shape, every = [], [], []
    for organ, count in PATIENTS.items():
        most = given.patients if organ == "small-bowel" else min(given.patients, given.others)
        patients = range(1, min(count, most) + 1)
        sequences = recorded(given.work / "default", organ, patients)
        every += sequences
        sets.append(described(organ, sequences))
        shape.append((organ, *near_wall(sequences)))
        if given.ablations is not None and organ == "small-bowel":
            patients = patients[:ABLATED]
            without = {name: ABLATIONS[name] for name in given.ablations or ABLATIONS}
            for name, options in {f"first {ABLATED} patients": (), **without}.items():
                folder = given.work / (name.replace(" ", "-") if options else "default")
                changed = recorded(folder, organ, patients, options)
                sets.append(described(f"{organ}, {name}", changed))
                shape.append((f"{organ}, {name}", *near_wall(changed)))
    sets.insert(0, described("all organs", every))
    sets += [described(name, read_source(str(REAL / path))) for name, path in PEERS.items()]
    rows = [row(one) for one in compare(real, [*sets, constant(real)])]
    first, second = halves(real)
    rows.append(("halves of the real set", *row(compare(first, [second])[0])[1:]))
    write_section(given.out, Path(__file__), text(len(real.images), rows, shape), title=TITLE)


def text(count: int, rows: list[tuple[str, ...]], shape: list[tuple[str, ...]]) -> str:
    """Section of the page."""
    return "\n\n".join(
        (
            f"Default settings, nothing fitted to single images, compared with {count} images of "
            "WCEBleedGen without bleeding (training and validation). Measures: "
            "[guide](../how-to/compare-looks.md). R is the pooled KID divided by "
            f"{RECORDERS_APART}, its value between two real sets of different recorders. The "
            "parameters of image chain and mucosae were chosen on images of the same reference, "
            "so that an unseen reference gives larger distances.",
            table(COLUMNS, rows),
            "Depth of the rendered images, and the fractions of the view nearer than 5 mm, of "
            "frames with a quarter of the view nearer than 5 mm (wall on the dome), and of frames "
            "whose deepest hundredth is beyond 30 mm (open lumen):",
            table(("set", "depth, 10 / 50 / 90 %", "near", "wall on the dome", "open"), shape),
        )
    )


if __name__ == "__main__":
    main()
