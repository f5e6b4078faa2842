"""Draw the pictures of lesions: one of each kind and grade in a generated colon, and its twin.

python -m docs.images.lesions
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

import vrcaps
from vrcaps import _core
from vrcaps._core import Wall
from vrcaps.camera.camera import Camera, camera_rays
from vrcaps.core.color import luminance
from vrcaps.core.geometry import invert, look_along, transform_from
from vrcaps.core.units import MM
from vrcaps.lesion import LesionPair, add_lesions, parse_lesion
from vrcaps.organ.surface import OrganSurface, interpolate
from vrcaps.world.model import State

ROWS = {
    "polyps": (
        *("polyp-Ip-tubular:segment=sigmoid", "polyp-Is-tubular:segment=descending"),
        *("polyp-IIa-serrated:segment=transverse", "polyp-IIb:segment=ascending,size=10mm"),
        *("polyp-IIc-tubular:segment=transverse", "polyp-Is-villous:segment=sigmoid,size=16mm"),
        *("polyp-Ip-inflammatory:segment=descending", "polyp-Is-hyperplastic:segment=transverse"),
    ),
    "inflammation and blood": (
        *("colitis-1:spread=12cm,segment=ascending", "colitis-2:spread=12cm,segment=descending"),
        *("colitis-3:spread=12cm,segment=sigmoid", "bleeding-1:segment=transverse"),
        *("bleeding-2:segment=transverse", "bleeding-3:segment=transverse"),
        *("bleeding-4:segment=rectum", "erosion:segment=caecum,size=6mm"),
    ),
    "others": (
        *("angioectasia:segment=ascending,size=6mm", "ulcer-aphthous:segment=transverse,size=7mm"),
        *("ulcer-deep:segment=sigmoid,size=16mm", "stricture:segment=descending"),
        *("diverticulum:segment=sigmoid,size=7mm", "tumor:segment=ascending,size=24mm"),
        *("lymphangiectasia:segment=ascending", "polyp-IIa-villous:segment=rectum,size=20mm"),
    ),
}
SIDE_PX = 220
VIEWS, RAY_STEP = 300, 8  # places tried for each lesion, and every which ray of them is cast
SHARE = 0.16  # of the view that a lesion shall take
RINGS = ("stricture",)  # kinds seen along the lumen
CLEAR = 4.0 * MM  # least way from the wall to a camera
UP = np.array([0.1, 0.2, 1.0])  # in pictures, patient frame
LUMINANCE = 0.15  # mean linear luminance of each frame; that of real capsule frames


def best_view(
    organ: OrganSurface, wall: Wall, number: int, camera: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """Position in the lumen from which a camera sees a lesion best.

    That is: it takes `SHARE` of the view, more counted in the middle, all of it is seen, no other
    lesion is, and little stands nearer than it does. What narrows the lumen is looked at along it.

    Args:
        organ: With lesions.
        wall: Its surface, in the patient frame.
        number: The lesion's instance.
        camera: Which sees it.

    Returns:
        Where the camera is, and what it looks at [m], patient frame.
    """
    own = np.flatnonzero(organ.instance == number)
    is_own = (organ.instance == number)[organ.faces].any(axis=1)
    is_other = (organ.instance > 0)[organ.faces].any(axis=1) & ~is_own
    rays = camera_rays(camera)[::RAY_STEP, ::RAY_STEP].reshape(-1, 3)
    rays = rays[np.isfinite(rays).all(axis=1)].astype(float)
    weight = rays[:, 2] ** 2 / (rays[:, 2] ** 2).sum()
    rng = np.random.default_rng(0)
    is_ring = organ.metadata["lesions"][number - 1]["kind"] in RINGS
    best, best_score = (organ.vertices[own[0]], organ.vertices[own[0]]), -np.inf
    for _ in range(VIEWS):
        vertex = rng.choice(own)
        target = _on_axis(organ, own) if is_ring else organ.vertices[vertex]
        eye = _in_lumen(organ, float(organ.arc_length[vertex]), rng)
        if wall.signed_distance(eye[None])[0] < CLEAR:
            continue
        turn = look_along(target - eye, UP)
        distance, face = wall.cast(np.tile(eye, (len(rays), 1)), rays @ turn.T)
        seen = (face >= 0) & is_own[face]
        if not seen.any():
            continue
        some = organ.vertices[rng.choice(own, 60)]
        whole = wall.visible(tuple(eye), eye + 0.98 * (some - eye)).mean()
        share = weight[seen].sum()
        before = weight[~seen & (distance < 0.6 * np.median(distance[seen]))].sum()
        aside = before + weight[(face >= 0) & is_other[face]].sum()
        score = min(share / SHARE, 1.0) - max(share - 2.5 * SHARE, 0.0) + whole - aside
        if score > best_score:
            best, best_score = (eye, target), score
    return best


def _on_axis(organ: OrganSurface, own: np.ndarray) -> np.ndarray:
    """The middle of the lumen where a lesion is that goes around it."""
    return interpolate(organ.centerline, np.array([organ.arc_length[own].mean()]))[0][0]


def _in_lumen(organ: OrganSurface, near: float, rng: np.random.Generator) -> np.ndarray:
    """A place on or beside the centerline, not far from an arc length."""
    at = np.clip(near + rng.uniform(-45.0, 45.0) * MM, 4 * MM, organ.centerline.length - 4 * MM)
    point, frame, radius = interpolate(organ.centerline, np.array([at]))
    return point[0] + frame[0, :, :2] @ (0.75 * radius[0] * rng.uniform(-1.0, 1.0, 2))


def view(renderers, model: vrcaps.Model, record: dict) -> tuple[np.ndarray, np.ndarray]:
    """The same frame with the lesion and without."""
    organ, camera = renderers[0].model.organ, model.device.cameras[0]
    wall = vrcaps.Model(organ, model.device, np.eye(4)).wall
    eye, target = best_view(organ, wall, record["instance"], camera)
    pose = transform_from(look_along(target - eye, UP), eye) @ invert(camera.T_capsule_camera)
    state = State(0.0, model.T_world_patient @ pose)
    frames = [renderer.render(state, camera, channels=("radiance",)) for renderer in renderers]
    exposure = even_exposure(np.nan_to_num(frames[0].radiance))
    sick, clean = (_core.encode_srgb(np.nan_to_num(f.radiance), exposure) for f in frames)
    return sick, clean


def even_exposure(radiance: np.ndarray, mean_luminance: float = LUMINANCE) -> float:
    """The exposure that an automatic control would choose, for linear radiance.

    The mean luminance over the field of view, clipped at white, becomes `mean_luminance`, as
    endoscopes and capsules adapt their light from frame to frame.
    """
    seen = radiance.any(axis=-1)
    low, high, exposure = 0.0, 1e3 / max(float(radiance.mean()), 1e-12), 0.0
    for _ in range(50):
        exposure = 0.5 * (low + high)
        value = luminance(np.minimum(radiance[seen] * exposure, 1.0)).mean()
        low, high = (exposure, high) if value < mean_luminance else (low, exposure)
    return exposure


def tile(image: np.ndarray, text: str) -> np.ndarray:
    """A frame in the picture's size with its name."""
    picture = Image.fromarray(image).resize((SIDE_PX, SIDE_PX), Image.Resampling.LANCZOS)
    ImageDraw.Draw(picture).text((4, SIDE_PX - 14), text, fill=(230, 230, 230))
    return np.asarray(picture)


def main(folder: Path) -> None:
    """One patient for each row; each lesion above the same view of the clean twin."""
    device = vrcaps.read_device("mirocam")
    settings = vrcaps.RenderSettings(supersampling=2, shadows=True, light="radiosity")
    bands = []
    for seed, texts in enumerate(ROWS.values()):
        lesions = [parse_lesion(text) for text in texts]
        organ = vrcaps.generate_organ("colon", seed=0)
        patient: LesionPair = add_lesions(organ, lesions, np.random.default_rng(seed))
        models = [vrcaps.Model(side, device) for side in (patient.organ, patient.clean)]
        renderers = [vrcaps.Renderer(model, settings) for model in models]
        pairs = [view(renderers, models[0], record) for record in patient.organ.metadata["lesions"]]
        names = [text.split(":")[0] for text in texts]
        bands.append(np.hstack([tile(sick, n) for (sick, _), n in zip(pairs, names, strict=True)]))
        if seed == 0:
            bands.append(np.hstack([tile(clean, "clean twin") for _, clean in pairs]))
    Image.fromarray(np.vstack(bands)).save(folder / "lesions.jpg", quality=88)


if __name__ == "__main__":
    main(Path(__file__).parent)
