"""Draw every effect by every grade, and write the table of grades.

python docs/images/effects.py
"""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from vrcaps.anatomy.catalog import generate_organ
from vrcaps.camera_pipeline.effects import Effects
from vrcaps.camera_pipeline.pipeline import CameraChain, Moment
from vrcaps.camera_pipeline.severities import GRADES, HIGHEST
from vrcaps.capsule.catalog import read_device
from vrcaps.capsule.device import Device
from vrcaps.lumen.contents import Contents
from vrcaps.motion.fly_through import FlyThrough, fly_through
from vrcaps.organ.surface import OrganSurface
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings
from vrcaps.world.model import Model, State

SIDE_PX = 200
MARGIN_PX = 130
LOOK = RenderSettings(supersampling=2, shadows=True, light="radiosity")
FRAMES = 3
FPS = 3.0
DARK = 0.12
"""Exposure that the automatic exposure begins with, in its row."""
DOCS = Path(__file__).resolve().parents[1]
START, STOP = "<!-- grades -->", "<!-- end of grades -->"


def states(organ: OrganSurface, device: Device) -> list[State]:
    """Neighbouring frames of a flight."""
    model = Model(organ, device)
    flight = FlyThrough(start=0.62, end=0.62 + 0.012 * FRAMES / 2, drift=0.45)
    rng = np.random.default_rng(4)
    run = fly_through(model, flight, frames=FRAMES, fps=FPS, rng=rng)
    return [run.state(k) for k in range(FRAMES)]


def picture(renderer: Renderer, device: Device, effects: Effects, run: list[State]) -> Image.Image:
    """The middle frame of a flight, through these effects."""
    camera = effects.device(device).cameras[0]
    chain = CameraChain(effects, camera, number=0, fps=FPS, seed=1)
    moment = Moment(1, run[1], run[2], run[0])
    automatic, seen = effects.figures("exposure"), chain.see(renderer, moment, ("rgb",))
    if automatic is not None:
        exposure = DARK
        for _ in range(FRAMES):
            metered = chain.meter(seen, replace(moment, exposure=exposure))
            exposure = automatic.following(exposure, metered, 1.0 / FPS)
        moment = replace(moment, exposure=exposure)
    rgb = chain.apply(seen, renderer, moment).rgb
    resample = Image.Resampling.NEAREST if effects.resolution else Image.Resampling.BOX
    return Image.fromarray(np.asarray(rgb)).resize((SIDE_PX, SIDE_PX), resample)


def draw_sheet(path: Path) -> None:
    """One row for each effect, one column for each grade."""
    organ, device = generate_organ("colon", seed=0), read_device("mirocam")
    run, plain = states(organ, device), Renderer(Model(organ, device), LOOK)
    size = (MARGIN_PX + (HIGHEST + 1) * SIDE_PX, len(GRADES) * SIDE_PX + 16)
    sheet = Image.new("RGB", size, (24, 24, 28))
    pen = ImageDraw.Draw(sheet)
    for grade in range(HIGHEST + 1):
        pen.text((MARGIN_PX + grade * SIDE_PX + 6, 2), f"grade {grade}", fill=(230, 230, 230))
    for row, name in enumerate(GRADES):
        top = 16 + row * SIDE_PX
        pen.text((6, top + SIDE_PX // 2), name, fill=(230, 230, 230))
        for grade in range(HIGHEST + 1):
            effects, in_use = Effects(**{name: grade}), plain
            if name in ("specular", "bubbles"):
                contents = effects.contents(Contents(seed=5))
                in_use = Renderer(Model(effects.organ(organ), device, contents=contents), LOOK)
            tile = picture(in_use, device, effects, run)
            sheet.paste(tile, (MARGIN_PX + grade * SIDE_PX, top))
    sheet.save(path, quality=88)


def described(figures: Any) -> str:
    """Figures of a grade in words."""
    if figures is None:
        return "–"
    if not is_dataclass(figures):
        return str(figures)
    parts = []
    for field in fields(figures):
        value = getattr(figures, field.name)
        if value != field.default:
            numbers = [f"{v:g}" for v in (value if isinstance(value, tuple) else (value,))]
            text = numbers[0] if len(numbers) == 1 else f"({', '.join(numbers)})"
            parts.append(f"{field.name} {text}")
    return ", ".join(parts)


def table() -> str:
    """The grades as a Markdown table, SI units; what is not named is as in the class."""
    lines = ["| effect | class | 0 | 1 | 2 | 3 | 4 |", "|---|---|---|---|---|---|---|"]
    for name, figures in GRADES.items():
        kind = f"`{type(figures[-1]).__name__}`" if is_dataclass(figures[-1]) else "number"
        lines.append(f"| `{name}` | {kind} | {' | '.join(map(described, figures))} |")
    return "\n".join(lines)


if __name__ == "__main__":
    draw_sheet(DOCS / "images" / "effects.jpg")
    page = DOCS / "effects.md"
    text = page.read_text(encoding="utf-8")
    before, after = text.split(START)[0], text.split(STOP)[1]
    page.write_text(f"{before}{START}\n{table()}\n{STOP}{after}", encoding="utf-8")
