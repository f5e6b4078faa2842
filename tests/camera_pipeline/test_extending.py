"""The lens and the effect that docs/how-to/extending.md adds."""

from pathlib import Path

import numpy as np
import pytest

from vrcaps.camera.camera import Camera
from vrcaps.camera.derive import focal_length_px, scaled_lens
from vrcaps.camera_pipeline.effect.base import Effect
from vrcaps.camera_pipeline.effects import EFFECTS

PAGE = (Path(__file__).parents[2] / "docs" / "how-to" / "extending.md").read_text(encoding="utf-8")


def example(heading: str) -> dict:
    """Names that the first code under a heading defines."""
    code = PAGE.split(f"## {heading}\n")[1].split("```python\n")[1].split("```")[0]
    names: dict = {"__name__": __name__}
    exec(compile(code, "docs/how-to/extending.md", "exec"), names)
    return names


def test_a_lens_model() -> None:
    lens = example("A lens model")["LensStereographic"](30.0, 31.5, 31.5)
    camera = Camera("front", lens, 64, 64)
    pixels = np.array([[31.5, 31.5], [40.0, 20.0], [0.0, 63.0]])
    np.testing.assert_allclose(camera.lens.project(lens.unproject(pixels)), pixels, atol=1e-9)
    assert focal_length_px(lens) == pytest.approx(30.0, rel=1e-6)
    assert scaled_lens(lens, 0.5, (15.5, 15.5)).focal == 15.0


def test_a_camera_effect() -> None:
    kind: type[Effect] = example("A camera effect")["WideAngle"]
    assert kind.name not in EFFECTS and kind.acts_on == "camera"
    lens = example("A lens model")["LensStereographic"](30.0, 31.5, 31.5)
    wide = kind.at(4)
    assert wide.on(Camera("front", lens, 64, 64)).lens.focal == pytest.approx(18.0)
    assert kind.parse("2") == 2 and kind.at(0) is None
