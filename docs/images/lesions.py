"""Draw the pictures of lesions: one of each kind and grade in a generated colon, and its twin.

python docs/images/lesions.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

import vrcaps
from vrcaps.organ.centerline import interpolate
from vrcaps.organ.lesion import Patient, add_lesions, parse_lesion
from vrcaps.transforms import look_along, transform_from
from vrcaps.units import MM
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
        *("colitis-3:spread=12cm,segment=sigmoid", "haemorrhage-1:segment=transverse"),
        *("haemorrhage-2:segment=transverse", "haemorrhage-3:segment=transverse"),
        *("haemorrhage-4:segment=rectum", "erosion:segment=caecum,size=6mm"),
    ),
    "others": (
        *("angioectasia:segment=ascending,size=6mm", "ulcer-aphthous:segment=transverse,size=7mm"),
        *("ulcer-deep:segment=sigmoid,size=16mm", "stricture:segment=descending"),
        *("diverticulum:segment=sigmoid,size=7mm", "tumour:segment=ascending,size=24mm"),
        *("lymphangiectasia:segment=ascending", "polyp-IIa-villous:segment=rectum,size=20mm"),
    ),
}
SIDE_PX = 220
CHANNELS = ("rgb", "instance")


def eye_of(organ: vrcaps.OrganSurface, wall, record: dict) -> np.ndarray:
    """Of many places on and beside the centreline the one that sees most of a lesion best."""
    own = organ.vertices[organ.instance == record["instance"]]
    center = own[np.argmin(np.linalg.norm(own - own.mean(axis=0), axis=1))]
    size = record["specification"].get("size", 20.0 * MM)
    wanted = np.clip(2.6 * size, 14.0 * MM, 45.0 * MM)
    rng = np.random.default_rng(0)
    best, best_score = center, -np.inf
    for offset in np.linspace(-45.0, 45.0, 37) * MM:
        at = np.clip(record["arc_length_m"] + offset, 8 * MM, organ.centerline.length - 8 * MM)
        point, frame, radius = interpolate(organ.centerline, np.array([at]))
        aside = 0.6 * radius[0] * rng.uniform(-1.0, 1.0, 2)
        for eye in (point[0], point[0] + frame[0, :, :2] @ aside):
            if wall.signed_distance(eye[None])[0] < 4.0 * MM:
                continue
            some = own[rng.integers(len(own), size=40)]
            seen = wall.visible(tuple(eye), eye + 0.995 * (some - eye)).mean()
            score = seen - abs(np.linalg.norm(eye - center) - wanted) / (20.0 * MM)
            if score > best_score:
                best, best_score = eye, score
    return best


def view(renderers, model: vrcaps.Model, record: dict) -> tuple[np.ndarray, np.ndarray]:
    """The same frame with the lesion and without."""
    organ = renderers[0].model.organ
    own = organ.vertices[organ.instance == record["instance"]]
    plain = vrcaps.Model(organ, model.device, np.eye(4))
    eye = eye_of(organ, plain.wall, record)
    target = own[np.argmin(np.linalg.norm(own - own.mean(axis=0), axis=1))]
    pose = transform_from(look_along(target - eye, np.array([0.1, 0.2, 1.0])), eye)
    state = State(0.0, model.T_world_patient @ pose)
    camera = model.device.cameras[0]
    frames = [renderer.render(state, camera, channels=CHANNELS) for renderer in renderers]
    return np.asarray(frames[0].rgb), np.asarray(frames[1].rgb)


def tile(image: np.ndarray, text: str) -> np.ndarray:
    """A frame in the picture's size with its name."""
    picture = Image.fromarray(image).resize((SIDE_PX, SIDE_PX), Image.Resampling.LANCZOS)
    ImageDraw.Draw(picture).text((4, SIDE_PX - 14), text, fill=(230, 230, 230))
    return np.asarray(picture)


def main(folder: Path) -> None:
    """One patient for each row; each lesion above the same view of the clean twin."""
    device = vrcaps.load_device("mirocam")
    settings = vrcaps.RenderSettings(supersampling=2, shadows=True)
    bands = []
    for seed, texts in enumerate(ROWS.values()):
        lesions = [parse_lesion(text) for text in texts]
        organ = vrcaps.load_organ("colon", seed=0)
        patient: Patient = add_lesions(organ, lesions, np.random.default_rng(seed))
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
