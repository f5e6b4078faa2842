"""Fit the palettes of the wall to real frames, under a kind of light.

The appearance of a wall depends on the light: light reflected several times is multiplied by its
color each time. For each class of real frames, the script fits factors on red, green and blue of
the base colors so that simulated frames have the same mean a* and b* and the same spread of L*, and
prints the colors for `vrcaps.mucosa.mucosa` and `vrcaps.lesion.colitis`.

    python -m benchmarks.appearance.fit
    python -m benchmarks.appearance.fit --only small-bowel --light direct
    python -m benchmarks.appearance.fit --only colon --carriers   # effect of other parameters

The base color scales the baked texture, so no organ is generated again. Exposure follows the mean,
so the level of the reflectance shows only through multiple reflection, and thus in the spread of
L*; it stays within `compare.RED`.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.appearance.camera import our_discs
from benchmarks.appearance.compare import DATA, HEAD_CHANNELS, RED, has_overlays, read_folder
from benchmarks.appearance.images import valid_pixels
from benchmarks.appearance.scenes import SETTINGS, scenes, shots
from benchmarks.appearance.statistics import by_channel, measured
from vrcaps import _core
from vrcaps.camera.derive import scaled_camera
from vrcaps.core.color import linear_from_srgb
from vrcaps.lesion.colitis import ACTIVITIES
from vrcaps.metrics.images import image_color
from vrcaps.mucosa.bake import bake_appearance
from vrcaps.mucosa.mucosa import MUCOSAE
from vrcaps.organ.surface import OrganSurface
from vrcaps.render.settings import RenderSettings
from vrcaps.world.model import Model

CLASSES = {
    "colon": {"clean_colon": 8, "polyp": 6},
    "small-bowel": {"capsule_non_bleeding": 6},
    "colitis 1": {"colitis_grade_1": 4},
    "colitis 2": {"colitis_grade_2": 4},
    "colitis 3": {"colitis_grade_3": 4},
}
"""Classes of real frames that show a tissue, and frames of ours of each patient, about."""
PATIENTS = 2
IMAGE_SCALE = 0.5
"""Scale of the images, relative to those compared: means and spreads hardly change."""
STEP = 0.25
"""Change of the logarithm of the level by which its slope is probed."""
LEVEL_WEIGHT = 0.3
"""Weight of the spread of L* compared with a* and b*: it has many causes."""
ROUNDS = 4
TOLERANCE = 1.2
"""Distance of `Looks.fitted` from the real frames' at which a palette is left as it stands, so
that of a fitted palette this prints the very figures [Lab units]: the standard error of the real
frames' mean a* or b*, 1.2 to 3.0 by class."""

CARRIERS = (
    *("redness_variation", "vessel_contrast", "network", "bile", "relief_slope", "pit_slope"),
    *("roughness", "clearcoat", "clearcoat_gloss"),
)
"""Fields of a mucosa that may carry spreads, gradients and highlights."""
LESS = 0.7
"""Factor by which each of them is multiplied, in turn."""
COARSE = 4.0
"""Texels per mm while they are compared."""


@dataclass(frozen=True)
class Looks:
    """Means over the frames of a set, in CIE L*a*b*."""

    mean: np.ndarray
    spread: np.ndarray

    @property
    def fitted(self) -> np.ndarray:
        """Mean a*, mean b*, weighted spread of L*."""
        return np.array([*self.mean[1:], LEVEL_WEIGHT * self.spread[0]])


def looks(sets: dict[str, list[np.ndarray]]) -> Looks:
    """Appearance statistics of discs by class; each class has the same weight."""
    means, spreads = [], []
    for name, discs in sets.items():
        valid = valid_pixels(has_overlays(name))
        colors = [image_color(image, valid) for image in discs]
        means.append(np.mean([color.mean for color in colors], axis=0))
        spreads.append(np.mean([color.spread for color in colors], axis=0))
    return Looks(np.mean(means, axis=0), np.mean(spreads, axis=0))


def real_looks(tissue: str) -> Looks:
    """Appearance statistics of the real frames of a tissue."""
    folder = DATA / "real_frames"
    return looks({name: read_folder(list((folder / name).iterdir())) for name in CLASSES[tissue]})


class Wall:
    """Simulated frames of a tissue whose base colors can be changed."""

    def __init__(self, tissue: str, settings: RenderSettings) -> None:
        self._scenes = {
            name: [(_small(model), states) for model, states in scenes(name, PATIENTS, frames)]
            for name, frames in CLASSES[tissue].items()
        }
        self._settings = settings

    def discs(self, logs: np.ndarray) -> dict[str, list[np.ndarray]]:
        """Statistics by class for logarithms of the factors on the color of the whole wall."""
        sets = {}
        for name, chosen in self._scenes.items():
            painted = ((_scaled(model, np.exp(logs)), states) for model, states in chosen)
            sets[name] = our_discs(name, shots(painted, self._settings))
        return sets


def _small(model: Model) -> Model:
    cameras = tuple(scaled_camera(camera, IMAGE_SCALE) for camera in model.device.cameras)
    return replace(model, device=replace(model.device, cameras=cameras))


def _scaled(model: Model, factors: np.ndarray) -> Model:
    organ: OrganSurface = model.organ
    look = organ.appearance
    assert look is not None
    linear = linear_from_srgb(np.arange(256, dtype=np.uint8)[:, None].repeat(3, axis=1)) * factors
    codes = _core.encode_srgb(linear[None].astype(np.float32), 1.0)[0]
    albedo = np.stack([codes[look.albedo[..., k], k] for k in range(3)], axis=-1)
    changed = replace(organ, appearance=replace(look, albedo=albedo))
    return replace(model, organ=changed)


def fit(wall: Wall, target: Looks, base: np.ndarray, *, is_free: bool) -> np.ndarray:
    """Logarithms of the factors on the base color, by Broyden's method.

    Args:
        wall: Ours.
        target: Of the real frames.
        base: Base color that the factors apply to.
        is_free: Whether the level is fitted; otherwise red is unchanged.
    """
    own = slice(0 if is_free else 1, 3)
    used = slice(0, 3 if is_free else 2)
    logs, sets, slope = np.zeros(3), wall.discs(np.zeros(3)), None
    found = looks(sets)
    for _ in range(ROUNDS):
        color = (base * np.exp(logs)).round(3)
        print(f"  {color}: mean {found.mean.round(1)}, spread {found.spread.round(1)}", flush=True)
        miss = (target.fitted - found.fitted)[used]
        if np.linalg.norm(miss) < TOLERANCE:
            break
        if slope is None:
            slope = first_slope(wall, sets, found, is_free=is_free)[used, own]
        step = np.zeros(3)
        step[own] = np.clip(np.linalg.lstsq(slope, miss, rcond=0.02)[0], -0.5, 0.5)
        if is_free:
            step[0] = np.log(np.clip(base[0] * np.exp(logs[0] + step[0]), *RED) / base[0]) - logs[0]
        logs, before = logs + step, found
        found = looks(wall.discs(logs))
        off = (found.fitted - before.fitted)[used] - slope @ step[own]
        slope += np.outer(off, step[own]) / max(float(step @ step), 1e-9)
    return logs


def first_slope(
    wall: Wall, sets: dict[str, list[np.ndarray]], found: Looks, *, is_free: bool
) -> np.ndarray:
    """Change of `Looks.fitted` by the logarithm of each factor, at factors of 1.

    Of green and blue as gains on the images would make it; of all three together as rendered.
    """
    slope = np.zeros((3, 3))
    for k in (1, 2):
        gains = np.exp(0.1 * np.eye(3)[k])
        slope[:, k] = (looks(_gained(sets, gains)).fitted - found.fitted) / 0.1
    if is_free:
        level = looks(wall.discs(np.full(3, STEP))).fitted - found.fitted
        slope[:, 0] = level / STEP - slope[:, 1] - slope[:, 2]
    return slope


def _gained(sets: dict[str, list[np.ndarray]], gains: np.ndarray) -> dict[str, list[np.ndarray]]:
    def gained(rgb: np.ndarray) -> np.ndarray:
        return _core.encode_srgb((linear_from_srgb(rgb) * gains).astype(np.float32), 1.0)

    return {name: [gained(rgb) for rgb in discs] for name, discs in sets.items()}


def carriers(tissue: str, settings: RenderSettings) -> Iterator[tuple[str, ...]]:
    """Spread, gradient and highlights of simulated frames with each of `CARRIERS` lowered."""
    name, frames = next(iter(CLASSES[tissue].items()))
    chosen = [(_small(model), states) for model, states in scenes(name, 1, frames)]
    valid = valid_pixels(has_overlays(name))
    for field in ("", *CARRIERS):
        mucosa = MUCOSAE[tissue]
        if field:
            mucosa = replace(mucosa, **{field: LESS * getattr(mucosa, field)})
        painted = []
        for model, states in chosen:
            look = bake_appearance(model.organ, seed=0, mucosa=mucosa, texels_per_mm=COARSE)
            painted.append((replace(model, organ=replace(model.organ, appearance=look)), states))
        found = measured(our_discs(name, shots(painted, settings)), valid)
        label = f"{field} × {LESS}" if field else "as it is"
        yield next(iter(by_channel(label, {"ours": found})))


def base_of(tissue: str) -> np.ndarray:
    """The color that a tissue's factors apply to: of a mucosa, or the colon's under colitis."""
    return np.array(MUCOSAE[tissue if tissue in MUCOSAE else "colon"].base_color)


def main() -> None:
    """Fit and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=list(CLASSES), help="tissues")
    parser.add_argument("--light", default=SETTINGS.light, help="kind of light")
    parser.add_argument("--carriers", action="store_true", help="what else moves the statistics")
    given = parser.parse_args()
    settings = replace(SETTINGS, light=given.light, supersampling=1)
    colon = np.zeros(3)
    if given.carriers:
        for tissue in given.only:
            print(HEAD_CHANNELS, *carriers(tissue, settings), sep="\n")
        return
    for tissue in given.only:
        target, base, is_mucosa = real_looks(tissue), base_of(tissue), tissue in MUCOSAE
        print(f"{tissue}: real mean {target.mean.round(1)}, spread {target.spread.round(1)}")
        logs = fit(Wall(tissue, settings), target, base, is_free=is_mucosa)
        if tissue == "colon":
            colon = logs
        if is_mucosa:
            print(f"  base_color={tuple((base * np.exp(logs)).round(3).tolist())}")
        else:
            tint = np.array(ACTIVITIES[int(tissue[-1])].tint) * np.exp(logs - colon)
            print(f"  tint={tuple(tint.round(3).tolist())}")


if __name__ == "__main__":
    main()
