"""Draw every effect at every severity.

python -m docs.images.effects
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from vrcaps.anatomy.catalog import generate_organ
from vrcaps.camera_pipeline.effect.base import MAX_SEVERITY
from vrcaps.camera_pipeline.effects import EFFECTS, SEVERITIES, Effects
from vrcaps.camera_pipeline.pipeline import CameraPipeline, PipelineState
from vrcaps.capsule.device import Device
from vrcaps.capsule.device_file import read_device
from vrcaps.lumen.contents import Contents
from vrcaps.motion.fly_through import FlyThrough, fly_through
from vrcaps.motion.motion import Step
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


def states(organ: OrganSurface, device: Device) -> list[State]:
    """Neighboring frames of a flight."""
    model = Model(organ, device)
    flight = FlyThrough(start=0.62, end=0.62 + 0.012 * FRAMES / 2, whole=True, drift=0.45)
    rng = np.random.default_rng(4)
    run = fly_through(model, flight, frames=FRAMES, fps=FPS, rng=rng)
    return [run.state(k) for k in range(FRAMES)]


def picture(renderer: Renderer, device: Device, effects: Effects, run: list[State]) -> Image.Image:
    """The middle frame of a flight, through these effects."""
    camera = effects.device(device).cameras[0]
    pipeline = CameraPipeline(renderer, camera, effects, fps=FPS, seed=1)
    if effects.auto_exposure:
        pipeline.state = PipelineState(DARK)
        for _ in range(FRAMES):  # of a scene that stays
            pipeline.expose(Step(1, run[1], run[0], run[2]))
    rgb = pipeline.capture(Step(1, run[1], run[0], run[2])).rgb
    resample = Image.Resampling.NEAREST if effects.resolution else Image.Resampling.BOX
    return Image.fromarray(np.asarray(rgb)).resize((SIDE_PX, SIDE_PX), resample)


def draw_sheet(path: Path) -> None:
    """One row for each effect, one column for each severity."""
    organ, device = generate_organ("colon", seed=0), read_device("mirocam")
    run, plain = states(organ, device), Renderer(Model(organ, device), LOOK)
    size = (MARGIN_PX + (MAX_SEVERITY + 1) * SIDE_PX, len(SEVERITIES) * SIDE_PX + 16)
    sheet = Image.new("RGB", size, (24, 24, 28))
    pen = ImageDraw.Draw(sheet)
    for severity in range(MAX_SEVERITY + 1):
        pen.text(
            (MARGIN_PX + severity * SIDE_PX + 6, 2), f"severity {severity}", fill=(230, 230, 230)
        )
    for row, name in enumerate(SEVERITIES):
        top = 16 + row * SIDE_PX
        pen.text((6, top + SIDE_PX // 2), name, fill=(230, 230, 230))
        for severity in range(MAX_SEVERITY + 1):
            effects, in_use = Effects(**{name: severity}), plain
            if EFFECTS[name].acts_on == "scene":
                contents = effects.contents(Contents(seed=5))
                in_use = Renderer(Model(effects.organ(organ), device, contents=contents), LOOK)
            tile = picture(in_use, device, effects, run)
            sheet.paste(tile, (MARGIN_PX + severity * SIDE_PX, top))
    sheet.save(path, quality=88)


if __name__ == "__main__":
    draw_sheet(DOCS / "images" / "effects.jpg")
