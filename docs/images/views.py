"""Places of a generated colon as a capsule sees them, for pictures that compare."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

import vrcaps

SHOWN = (3, 9, 14, 17)  # of 20 frames along the whole colon


def recorded(scenario: vrcaps.Scenario) -> list[dict[str, np.ndarray]]:
    """Arrays of the frames of a scenario, as it records them."""
    with tempfile.TemporaryDirectory() as folder:
        vrcaps.record(scenario, Path(folder) / "run")
        episode = vrcaps.read_episode(Path(folder) / "run")
        return [dict(episode[index]) for index in range(len(episode))]


def view_row(model: vrcaps.Model, **settings: object) -> np.ndarray:
    """The places side by side, with radiosity with shadows and with further settings."""
    chosen = {"supersampling": 2, "shadows": True, "light": "radiosity", **settings}
    renderer = vrcaps.Renderer(model, vrcaps.RenderSettings(**chosen))  # type: ignore[arg-type]
    rng, camera = np.random.default_rng(0), model.device.cameras[0]
    flight = vrcaps.fly_through(model, vrcaps.FlyThrough(whole=True), frames=20, fps=3.0, rng=rng)
    images = [renderer.render(flight.state(k), camera, channels=("rgb",)).rgb for k in SHOWN]
    return np.hstack([np.asarray(image) for image in images])


def save_rows(rows: list[np.ndarray], path: Path) -> None:
    """Rows of four places below each other, 250 pixels to a place."""
    sheet = Image.fromarray(np.vstack(rows))
    sheet.resize((1000, 250 * len(rows)), Image.Resampling.LANCZOS).save(path, quality=88)
