"""Claim: an episode's organ file has a fifth of the size of the exact file, with equal images.

Renders a flight through the default colon with the textures as each coding gives them back, and
compares with the exact ones; then measures the two files of `write_organ`. Writes the table in
docs/concepts/datasets.md. For example: ``python -m benchmarks.speed.organ_files --size 24``.
"""

from __future__ import annotations

import io
import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from unittest import mock

import numpy as np
from PIL import Image

from benchmarks.common.scripts import options, table, write_section
from vrcaps import _core
from vrcaps.core.units import UM
from vrcaps.motion.fly_through import FlyThrough
from vrcaps.organ import gltf_material
from vrcaps.organ.gltf_material import (
    ALBEDO_STEP,
    RELIEF_STEP,
    ROUGHNESS_QUALITY,
    albedo_webp,
    decode_webps,
    relief_from_image,
    relief_webp,
    roughness_webp,
)
from vrcaps.organ.organ_file import write_organ
from vrcaps.organ.read_organ import read_organ
from vrcaps.organ.surface import HEIGHT_STEP, Appearance, OrganSurface
from vrcaps.render.renderer import Renderer
from vrcaps.scenario.build import build
from vrcaps.scenario.scenario import Scenario

_MB = 1e6


@dataclass(frozen=True)
class Flight:
    """Images of the organ from the same poses for any textures."""

    model: object
    states: list
    exact: np.ndarray

    def differences(self, organ: OrganSurface) -> np.ndarray:
        """Largest difference of a color from that with the exact organ, for each pixel."""
        images = draw(replace(self.model, organ=organ), self.states)
        return np.abs(images.astype(int) - self.exact).max(axis=-1)


def draw(model, states: list) -> np.ndarray:
    """Color images of the capsule's first camera, as recordings have them by default."""
    renderer, camera = Renderer(model), model.device.cameras[0]
    return np.stack([renderer.render(s, camera, channels=("rgb",)).rgb for s in states])


def jpeg(albedo: np.ndarray, quality: int) -> bytes:
    """Base color as JPEG without subsampled colors."""
    file = io.BytesIO()
    Image.fromarray(albedo).save(file, "JPEG", quality=quality, subsampling=0, optimize=True)
    return file.getvalue()


def stepped(name: str, value: float, code: Callable[[], bytes | None]) -> bytes:
    """Result of `code` with another constant of `gltf_material`."""
    before = getattr(gltf_material, name)
    setattr(gltf_material, name, value)
    try:
        data = code()
    finally:
        setattr(gltf_material, name, before)
    assert data is not None
    return data


def codings(
    look: Appearance,
) -> list[tuple[str, str, Callable[[], bytes], Callable[[bytes], dict]]]:
    """Texture, coding, encoder, and decoder to a field of the appearance."""

    def picture(data: bytes) -> dict:
        return {"albedo": np.array(Image.open(io.BytesIO(data)))}

    def webp(data: bytes) -> dict:
        return {"albedo": decode_webps([memoryview(data)])[0]}

    rows = [
        ("base color", "PNG", lambda: _core.encode_pngs([look.albedo])[0], lambda _: {}),
        *(("base color", f"JPEG, quality {q}", lambda q=q: jpeg(look.albedo, q), picture)
          for q in (80, 90, 95)),
        *(("base color", f"WebP, steps of {s}",
           lambda s=s: stepped("ALBEDO_STEP", s, lambda: albedo_webp(look.albedo)), webp)
          for s in (1, 3, ALBEDO_STEP, 7)),
    ]  # fmt: skip
    for factor in (4, 8, 16, 32, 64, 128):
        step = factor * HEIGHT_STEP
        rows.append(
            (
                "relief",
                f"WebP, steps of {step / UM:.2f} µm",
                lambda s=step: stepped("RELIEF_STEP", s, lambda: relief_webp(look.height)),
                lambda data, s=step: {
                    "height": relief_from_image(decode_webps([memoryview(data)])[0], s)
                },
            )
        )
    for quality in (ROUGHNESS_QUALITY, 75):
        rows.append(
            (
                "roughness",
                f"WebP, quality {quality}",
                lambda q=quality: stepped(
                    "ROUGHNESS_QUALITY", q, lambda: roughness_webp(look.roughness)
                ),
                lambda data: {"roughness": decode_webps([memoryview(data)])[0][..., 1].copy()},
            )
        )
    return rows


def row(name: str, coding: str, size: int, seconds: float, found: np.ndarray) -> tuple[str, ...]:
    """A row of the table."""
    shares = [f"{(found > limit).mean():.2%}" for limit in (1, 3)]
    return (
        name, coding, f"{size / _MB:.1f}", f"{seconds:.1f}", f"{found.max()}", *shares,
        f"{found.mean():.2f}",
    )  # fmt: skip


def main() -> None:
    """Measure and write the table."""
    given = options(__doc__ or "", 24)
    model, motion = build(Scenario(frames=given.size, motion=FlyThrough(whole=True)))
    states = [step.state for step in motion.steps()]
    flight = Flight(model, states, draw(model, states).astype(int))
    look = model.organ.appearance
    assert look is not None
    rows = []
    for name, coding, encode, decode in codings(look):
        began = time.process_time()
        data = encode()
        seconds = time.process_time() - began
        changed = replace(model.organ, appearance=replace(look, **decode(data)))
        rows.append(row(name, coding, len(data), seconds, flight.differences(changed)))
        print(*rows[-1], sep=" | ", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for compact in (False, True):
            path = Path(folder) / "organ.glb"
            with mock.patch.dict(os.environ, VRCAPS_CACHE=folder):  # codes textures anew
                began = time.process_time()
                write_organ(path, model.organ, compact=compact)
            seconds, size = time.process_time() - began, path.stat().st_size
            found = flight.differences(read_organ(path))
            name = "**compact file**" if compact else "**exact file**"
            rows.append(row(name, "as episodes have it" if compact else "`vrcaps organ make`",
                            size, seconds, found))  # fmt: skip
    height, width = look.height.shape
    text = f"""## Organ file size

Default colon, {len(model.organ.faces):,} triangles, {width} × {height} texels;
{given.size} images of {model.device.title} along it, with radiosity
and shadows, rendered with the textures that come back from the file. The difference is that of
the worst color of a pixel, in steps of 255. Compact files have a base color in steps of
{ALBEDO_STEP}, a relief in steps of {RELIEF_STEP / UM:.2f} µm and a roughness of quality
{ROUGHNESS_QUALITY}.

"""
    head = ["texture", "coding", "MB", "s of a processor", "largest"]
    head += ["beyond 1", "beyond 3", "mean"]
    write_section(given.out, Path(__file__), text + table(head, rows))


if __name__ == "__main__":
    main()
