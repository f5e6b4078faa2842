"""Draw docs/reference/gallery.md: organs, segments, distensions, lesions and grades.

    python -m benchmarks.appearance.gallery                    # everything
    python -m benchmarks.appearance.gallery --only lesions     # some sheets again

The sheets go to docs/images, the page's text before the first section that another script
writes is replaced.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

import vrcaps
from benchmarks.appearance.scenes import SETTINGS, at_lesions, exposed
from benchmarks.common.scripts import ROOT
from docs.images.views import recorded
from vrcaps.lesion.polyp import PATTERNS
from vrcaps.organ.segments import DISTENSIONS
from vrcaps.organ.surface import OrganSurface
from vrcaps.world.model import Model, State

PAGE = ROOT / "docs" / "reference" / "gallery.md"
TILE_PX = 200
LUMINANCE = 0.15
"""Mean linear luminance of each frame; that of real capsule frames."""
CAPTION_PX = 16
COLUMNS = 6

Tile = tuple[np.ndarray, str]
"""An image and its caption."""


@dataclass(frozen=True)
class Sheet:
    """A contact sheet of the page.

    Attributes:
        name: Name of its file; `--only` selects by its first letters.
        title: Heading.
        text: Description of its content.
        commands: Commands that record such frames.
        tiles: Makes its tiles.
        columns: Tiles in a row.
    """

    name: str
    title: str
    text: str
    commands: tuple[str, ...]
    tiles: Callable[[], list[Tile]]
    columns: int = COLUMNS


def frames(model: Model, states: list[State]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Color, evenly exposed, and labels of each state."""
    renderer = vrcaps.Renderer(model, SETTINGS)
    made = []
    for state in states:
        frame = renderer.render(state, model.device.cameras[0], channels=("radiance", "label"))
        made.append((exposed(np.nan_to_num(frame.radiance), LUMINANCE), frame.label))
    return made


def flight(organ: OrganSurface, capsule: str, number: int, seed: int = 0) -> tuple[Model, list]:
    """A flight along the whole organ."""
    model = Model(organ, vrcaps.read_device(capsule))
    rng = np.random.default_rng(seed)
    path = vrcaps.fly_through(model, vrcaps.FlyThrough(whole=True), frames=number, fps=1.0, rng=rng)
    return model, [path.state(k) for k in range(number)]


def of_recordings() -> list[Tile]:
    """Random views of each organ, as the camera pipeline encodes them by default."""
    tiles = []
    for name in ("small-bowel", "stomach", "colon"):
        scenario = vrcaps.Scenario(
            organ=vrcaps.OrganGenerated(name, seed=1),
            seed=1,
            capsule="mirocam",
            motion=vrcaps.RandomViews(),
            frames=COLUMNS,
            channels=("rgb",),
        )
        tiles += [(frame["rgb"], name) for frame in recorded(scenario)]
    return tiles


def of_segments(name: str, capsule: str, each: int) -> list[Tile]:
    """Frames of each segment that show the largest area from nearby, one for each of its parts."""
    organ = vrcaps.generate_organ(name, seed=0)
    model, states = flight(organ, capsule, 60)
    seen = frames(model, states)
    numbers = range(len(organ.label_names))
    fractions = np.array([[np.mean(label == k) for k in numbers] for _, label in seen])
    T_patient_world = np.linalg.inv(model.T_world_patient)
    eyes = np.array([(T_patient_world @ state.T_world_capsule)[:3, 3] for state in states])
    away = np.linalg.norm(organ.centerline.points - eyes[:, None], axis=-1)
    arc_lengths = organ.centerline.arc_length[away.argmin(axis=1)]
    tiles = []
    for k, segment in enumerate(organ.label_names):
        own = organ.arc_length[organ.label == k]
        if k == 0 or not len(own):
            continue
        borders = np.quantile(own, np.linspace(0.0, 1.0, each + 1))
        for low, high in pairwise(borders):
            fractions[(arc_lengths < low) | (arc_lengths > high), k] -= 1.0
            best = int(np.argmax(fractions[:, k]))
            fractions[best] -= 2.0  # shown once
            tiles.append((seen[best][0], segment.replace("_", " ")))
    return tiles


def of_distensions() -> list[Tile]:
    """Two frames of each organ in each distension."""
    tiles = []
    for name in ("stomach", "small-bowel", "colon"):
        for distension in DISTENSIONS:
            organ = vrcaps.generate_organ(name, seed=0, distension=distension)
            model, states = flight(organ, "mirocam", 8)
            for image, _ in frames(model, [states[2], states[5]]):
                tiles.append((image, f"{name}, {distension}"))
    return tiles


def of_tract() -> list[Tile]:
    """Evenly spaced frames from the duodenum to the rectum."""
    organ = vrcaps.generate_organ("full-tract", seed=1)
    model, states = flight(organ, "mirocam", 60)
    tiles = []
    for image, label in frames(model, states[1::5]):
        shown = np.bincount(label[label > 0], minlength=2).argmax()
        tiles.append((image, organ.label_names[shown].replace("_", " ")))
    return tiles


def of_patients() -> list[Tile]:
    """The same fraction of the centerline in different patients."""
    tiles = []
    for name, position, patients in (("colon", 3, 4), ("small-bowel", 4, 2)):
        for seed in range(patients):
            model, states = flight(vrcaps.generate_organ(name, seed=seed), "mirocam", 9, seed)
            tiles.append((frames(model, [states[position]])[0][0], f"{name}, patient {seed}"))
    return tiles


def of_capsules() -> list[Tile]:
    """The first camera of each capsule at one position."""
    tiles = []
    organ = vrcaps.generate_organ("colon", seed=1)
    for name in vrcaps.device_names():
        model, states = flight(organ, name, 9)
        tiles.append((frames(model, [states[6]])[0][0], name))
    return tiles


def of_lesions(organ: str, texts: tuple[str, ...], seed: int = 0) -> list[Tile]:
    """Best view of each lesion."""
    rng = np.random.default_rng([seed, 5])
    model, states = at_lesions(organ, seed, texts, vrcaps.read_device("mirocam"), rng)
    shown = frames(model, states)
    return [(image, caption(text)) for (image, _), text in zip(shown, texts, strict=True)]


def caption(text: str) -> str:
    """Name of a lesion and, of a polyp, its surface."""
    name, _, settings = text.partition(":")
    pattern = [item.removeprefix("pattern=") for item in settings.split(",") if "pattern" in item]
    return " ".join((name, *pattern))


def of_colitis() -> list[Tile]:
    """Three grades in one colon, each next to its border."""
    segments = {1: "ascending", 2: "transverse", 3: "descending"}
    texts = tuple(f"colitis-{mayo}:spread=25cm,segment={at}" for mayo, at in segments.items())
    return of_lesions("colon", texts) + of_lesions("colon", texts, seed=1)


POLYPS = tuple(
    f"polyp-{shape}:pattern={pattern},size={size}mm"
    for shape, size in (("Ip", 14), ("Is", 10), ("IIa", 13), ("IIb", 10), ("IIc", 12))
    for pattern in PATTERNS
)
BLEEDS = tuple(f"bleeding-{severity}" for severity in (1, 2, 3, 4))
OTHERS_COLON = (
    *("erosion:size=6mm", "ulcer-aphthous:size=7mm", "ulcer-deep:size=18mm"),
    *("tumor:segment=ascending,size=24mm", "diverticulum:segment=sigmoid,size=7mm", "stricture"),
)
OTHERS_BOWEL = (
    *("angioectasia:size=5mm", "lymphangiectasia", "erosion:size=5mm"),
    *("ulcer-aphthous:size=6mm", "ulcer-deep:size=10mm", "polyp-Is:size=8mm"),
)


_FINE = "--set render.supersampling=2 --set render.shadows=true"


def _record(*arguments: str) -> tuple[str, ...]:
    return tuple(f"vrcaps record --out runs/gallery {line}" for line in arguments)


SHEETS = (
    Sheet(
        "recorded",
        "As recorded",
        "Random views with default settings: automatic exposure, noise, sharpening and JPEG of the "
        "camera, and contents drawn by prevalence. Patient 1, six views of each organ.",
        _record("--organ small-bowel --patient-seed 1 --seed 1 --motion random-views --frames 6"),
        of_recordings,
    ),
    Sheet(
        *("segments_stomach", "Stomach", "Each segment of patient 0."),
        _record(f"--organ stomach {_FINE}"),
        partial(of_segments, "stomach", "mirocam", 1),
    ),
    Sheet(
        *("segments_small_bowel", "Small bowel", "Three positions in each segment of patient 0."),
        _record(f"--organ small-bowel --capsule pillcam-sb3 {_FINE}"),
        partial(of_segments, "small-bowel", "pillcam-sb3", 3),
    ),
    Sheet(
        *("segments_colon", "Colon", "Two positions in each segment of patient 0; MiroCam."),
        _record(f"--organ colon {_FINE}"),
        partial(of_segments, "colon", "mirocam", 2),
    ),
    Sheet(
        *("full_tract", "Full tract", "From the duodenum to the rectum, one wall; patient 1."),
        _record("--organ full-tract --patient-seed 1 --frames 600"),
        of_tract,
    ),
    Sheet(
        *(
            "distension",
            "Distension",
            "Inflated, normal, collapsed; patient 0, two positions each.",
        ),
        (
            *_record("--organ small-bowel --distension inflated"),
            "vrcaps organ make colon --distension collapsed --out collapsed.glb",
        ),
        of_distensions,
    ),
    Sheet(
        *("patients", "Patients", "A seed is a patient: anatomy, vessels, blood and bile."),
        _record("--organ colon --patient-seed 3", "--organ small-bowel --patient-seed 1"),
        of_patients,
    ),
    Sheet(
        *("capsules", "Capsules", "The catalog's devices at one position in patient 1."),
        _record("--capsule pillcam-colon2 --patient-seed 1"),
        of_capsules,
        7,
    ),
    Sheet(
        "lesions_polyps",
        "Polyps",
        "Rows: Paris Ip, Is, IIa, IIb, IIc. Columns: "
        + ", ".join(PATTERNS)
        + " surface. 10 to 14 mm, each at a location drawn at random; IIb are flat and hard to "
        "see.",
        _record("--lesion polyp-Ip:pattern=villous,size=14mm", "--lesion polyp-IIa-serrated"),
        partial(of_lesions, "colon", POLYPS),
        5,
    ),
    Sheet(
        *("lesions_colitis", "Ulcerative colitis", "Mayo 1, 2, 3 in patients 0 and 1."),
        _record("--lesion colitis-3:spread=25cm,segment=descending", "--lesion colitis-2-07"),
        of_colitis,
    ),
    Sheet(
        "lesions_bleeding",
        "Bleeding",
        "Severities 1 petechiae, 2 oozing, 3 streaming, 4 massive; colon, then small bowel. Blood "
        "flows with gravity: the patients lie on their backs.",
        _record("--lesion bleeding-3 --posture left-lateral", "--lesion bleeding-4-02"),
        lambda: of_lesions("colon", BLEEDS) + of_lesions("small-bowel", BLEEDS),
        4,
    ),
    Sheet(
        *("lesions_others", "Other lesions", "Colon, then small bowel."),
        _record("--lesion ulcer-deep:size=18mm", "--organ small-bowel --lesion angioectasia"),
        lambda: of_lesions("colon", OTHERS_COLON) + of_lesions("small-bowel", OTHERS_BOWEL),
    ),
)


def contact_sheet(tiles: list[Tile], columns: int) -> Image.Image:
    """Images side by side with their captions below."""
    rows = -(-len(tiles) // columns)
    size = (columns * TILE_PX, rows * (TILE_PX + CAPTION_PX))
    sheet = Image.new("RGB", size, (16, 16, 16))
    draw = ImageDraw.Draw(sheet)
    for number, (image, caption) in enumerate(tiles):
        x, y = number % columns * TILE_PX, number // columns * (TILE_PX + CAPTION_PX)
        picture = Image.fromarray(image)
        picture.thumbnail((TILE_PX - 4, TILE_PX - 4), Image.Resampling.LANCZOS)
        left, top = (TILE_PX - picture.width) // 2, (TILE_PX - picture.height) // 2
        sheet.paste(picture, (x + left, y + top))
        position = (x + TILE_PX // 2, y + TILE_PX + 1)
        draw.text(position, caption, fill=(225, 225, 225), anchor="ma")
    return sheet


def image_path(sheet: Sheet) -> Path:
    """Path of a sheet."""
    return ROOT / "docs" / "images" / f"gallery_{sheet.name}.jpg"


def section(sheet: Sheet) -> str:
    """Section of the page."""
    commands = "\n".join(sheet.commands)
    return (
        f"## {sheet.title}\n\n{sheet.text}\n\n![{sheet.title}: {sheet.text}]"
        f"(../images/gallery_{sheet.name}.jpg)\n\n```sh\n{commands}\n```\n"
    )


HEAD = """# Gallery

Frames of generated patients: every organ and segment, every kind and grade of lesion. One script
with fixed seeds, `python -m benchmarks.appearance.gallery`, draws them all with the capsules'
own LEDs and lenses; no picture is chosen by hand. Each lesion is seen from the one of 300 sampled
positions in the lumen from which most of it is visible and it fills a sixth of the view. The
commands below each sheet record such frames with all their labels. All sheets but the first show
the ideal camera without contents, each frame at the same mean luminance.

## Transit

Phase III carries a MiroCam through a collapsed jejunum in 20 s, as recorded,
without a film on the dome (`python -m docs.images.phase_three`).

![A collapsed jejunum carries a capsule along](../images/phase_three.webp)

"""


def write_page(page: Path) -> None:
    """Text of the page; sections of other scripts are kept."""
    mark = "<!-- written by "
    before = page.read_text(encoding="utf-8") if page.exists() else ""
    kept = mark + before.partition(mark)[2] if mark in before else ""
    drawn = [sheet for sheet in SHEETS if image_path(sheet).exists()]
    text = HEAD + "\n".join(section(sheet) for sheet in drawn)
    page.write_text(text + "\n" + kept if kept else text, encoding="utf-8")


def main() -> None:
    """Draw the sheets, write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=[""], help="beginnings of sheets' names")
    given = parser.parse_args()
    for sheet in SHEETS:
        if not sheet.name.startswith(tuple(given.only)):
            continue
        path = image_path(sheet)
        contact_sheet(sheet.tiles(), sheet.columns).save(path, quality=84)
        print(f"{path.relative_to(ROOT)}: {path.stat().st_size / 1e3:.0f} kB", flush=True)
    write_page(PAGE)


if __name__ == "__main__":
    main()
