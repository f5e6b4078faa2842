"""Draw what floats in the lumen, every grade in three organs, and write the table of grades.

python -m docs.images.contents
python -m docs.images.contents --only preparation   # residue in a cleansed colon
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from vrcaps.anatomy.catalog import generate_organ
from vrcaps.capsule.device_file import read_device
from vrcaps.core.color import luminance
from vrcaps.core.geometry import look_along, transform_from, transform_points
from vrcaps.core.units import MM
from vrcaps.lumen.contents import (
    BUBBLE_SEVERITIES,
    CHYME_SEVERITIES,
    CM2,
    LIQUID_SEVERITIES,
    Contents,
)
from vrcaps.lumen.preparation import prepared
from vrcaps.organ.surface import interpolate
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings
from vrcaps.world.model import Model, State

ORGANS = {"small-bowel": (0.31, 0.62), "stomach": (0.55, 0.75), "colon": (0.3, 0.7)}
"""Positions of the pictures of each organ, as fractions of the centerline."""

GRADES = ((0, 0, 0), (1, 1, 1), (2, 2, 2), (3, 3, 2), (4, 4, 3))
"""Bubbles, chyme and liquid of each column."""

SHEETS = {
    "contents": (
        ORGANS,
        {"bubbles {}, chyme {}, liquid {}".format(*g): Contents(*g) for g in GRADES},
    ),
    "preparation": (
        {"colon": (0.12, 0.4, 0.75)},
        {f"score {score}": prepared(score) for score in (3, 2, 1, 0)},
    ),
}
"""Organs and columns of each picture."""

AHEAD = 15.0 * MM
SIDE_PX = 200
LUMINANCE = 0.15  # mean linear luminance of each frame; that of real capsule frames
GIRTH = 2.0 * np.pi * 1.2  # of a small bowel 24 mm wide [cm]
DOCS = Path(__file__).resolve().parents[1]
START, STOP = "<!-- severities -->", "<!-- end of severities -->"


def view(model: Model, share: float) -> State:
    """A capsule on the centerline, looking a little further along it."""
    curve = model.organ.centerline
    at = share * curve.length + np.array([0.0, AHEAD])
    points = transform_points(model.T_world_patient, interpolate(curve, at)[0])
    rotation = look_along(points[1] - points[0], np.array([0.1, 0.2, 1.0]))
    return State(0.0, transform_from(rotation, points[0]))


def picture(model: Model, state: State) -> Image.Image:
    """A frame exposed to a fixed mean luminance, as a capsule's automatic exposure does."""
    camera = model.device.cameras[0]
    renderer = Renderer(model, RenderSettings(supersampling=2, shadows=True, light="radiosity"))
    radiance = renderer.render(state, camera, channels=("radiance",)).radiance
    exposure = camera.exposure
    for _ in range(8):
        bright = luminance(np.clip(np.asarray(radiance) * exposure, 0.0, 1.0))
        exposure *= LUMINANCE / float(bright[bright > 0.0].mean())
    exposed = replace(camera, exposure=exposure)
    rgb = renderer.render(state, exposed, channels=("rgb",)).rgb
    return Image.fromarray(np.asarray(rgb)).resize((SIDE_PX, SIDE_PX), Image.Resampling.LANCZOS)


def draw_sheet(name: str) -> None:
    """One row for each organ and place, one column for each filling."""
    organs, columns = SHEETS[name]
    rows = sum(len(shares) for shares in organs.values())
    sheet = Image.new("RGB", (len(columns) * SIDE_PX, rows * SIDE_PX + 16), (24, 24, 28))
    pen, row = ImageDraw.Draw(sheet), 0
    for column, text in enumerate(columns):
        pen.text((column * SIDE_PX + 6, 2), text, fill=(230, 230, 230))
    for organ_name, shares in organs.items():
        organ, device = generate_organ(organ_name, seed=0), read_device("mirocam")
        for column, contents in enumerate(columns.values()):
            model = Model(organ, device, contents=contents)
            for k, share in enumerate(shares):
                tile = picture(model, view(model, share))
                sheet.paste(tile, (column * SIDE_PX, 16 + (row + k) * SIDE_PX))
        row += len(shares)
    sheet.save(DOCS / "images" / f"{name}.jpg", quality=88)


def table() -> str:
    """The grades as a Markdown table."""
    lines = [
        "| severity | bubbles per cm² | per cm of a 24 mm wide gut | in a raft | radius [mm] "
        "| on each end of the capsule | particles per cm² | per cm | in a clump | radius [mm] "
        "| liquid, fraction of the lumen |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for grade, (bubbles, chyme, liquid) in enumerate(
        zip(BUBBLE_SEVERITIES, CHYME_SEVERITIES, LIQUID_SEVERITIES, strict=True)
    ):
        cells = [f"{grade}"]
        for kind, size in ((bubbles, bubbles.raft_size), (chyme, chyme.clump_size)):
            per_cm2 = kind.per_area * CM2
            cells += [f"{per_cm2:g}", f"{per_cm2 * GIRTH:.1f}"]
            some = f"{size:g}", f"{kind.radius / MM:g} (σ of the logarithm {kind.spread:g})"
            cells += some if per_cm2 else ("–", "–")
            if kind is bubbles:
                cells.append(f"{bubbles.on_dome}")
        lines.append(f"| {' | '.join([*cells, f'{liquid.fill:g}'])} |")
    return "\n".join(lines)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=list(SHEETS), choices=list(SHEETS))
    for chosen in parser.parse_args().only:
        draw_sheet(chosen)
    page = DOCS / "concepts" / "contents.md"
    text = page.read_text()
    before, after = text.split(START)[0], text.split(STOP)[1]
    page.write_text(f"{before}{START}\n{table()}\n{STOP}{after}")
