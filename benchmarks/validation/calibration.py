"""Claim: calibration recovers lenses from pictures of a chessboard.

Real photographs (`../shared/data/calibration`, skipped if absent) fit with mean errors no worse
than those published with them; boards rendered by catalog devices, LEDs and all, give the focal
length back within 0.5 %.

    python -m benchmarks.validation.calibration
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import ROOT, options, table, write_section
from vrcaps import _core
from vrcaps.capsule.device import Device
from vrcaps.capsule.device_file import read_device
from vrcaps.core.geometry import invert, transform_points
from vrcaps.core.units import DEG
from vrcaps.organ.surface import Appearance
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings
from vrcaps.tools.camera_calibration.board import Board, find_views
from vrcaps.tools.camera_calibration.circle import image_circle
from vrcaps.tools.camera_calibration.fit import Calibration, calibrate
from vrcaps.tools.camera_calibration.parameterization import PARAMETERIZATIONS
from vrcaps.tools.photos import Photo, read_photos
from vrcaps.world.model import Model, State

PHOTOS = ROOT.parent / "shared" / "data" / "calibration"
STORED = {"pinhole": "pinhole"}  # all others are compared with the fisheye fit
DEVICES = ("mono", "mirocam", "pillcam-colon2", "pillcam-sb3")
FITTED = {"equidistant": "kannala-brandt"}
"""Models fitted to lenses of a kind that cannot be fitted itself."""
BOARD = Board(8, 9, 2e-3)
MARGIN, TEXELS = 20, 16
"""White squares around the board, and texels of a square's side."""
TILT = 40.0 * DEG
PAGE = ROOT / "docs" / "how-to" / "calibration.md"


def photographs() -> list[tuple[str, ...]]:
    """Rows of the table of real photographs."""
    rows = []
    for folder in sorted(path for path in PHOTOS.glob("*") if path.is_dir()):
        stored = json.loads((folder / "calibration.json").read_text(encoding="utf-8"))
        columns, squares = map(int, stored["session"]["board_size_squares"])
        photos = read_photos([folder])
        views, missed = find_views(photos, board := Board(columns, squares, 2e-3))
        circle = image_circle([photo.rgb for photo in photos])
        height, width = photos[0].rgb.shape[:2]
        reach = None if circle is None else circle.radius
        for kind in PARAMETERIZATIONS:
            fit = calibrate(views, board, (width, height), kind, circle_px=reach)
            published = stored[STORED.get(kind, "fisheye")]["mean_reprojection_error_px"]
            found = f"{len(views)} of {len(views) + len(missed)}"
            rows.append((folder.name, found, kind, *errors(fit), f"{published:.3f}", focal(fit)))
    return rows


def errors(fit: Calibration) -> tuple[str, str]:
    """Mean and root mean square of a fit [px]."""
    return f"{fit.errors.mean():.3f}", f"{np.sqrt(np.mean(fit.errors**2)):.3f}"


def focal(fit: Calibration) -> str:
    """The first focal length and its deviation [px]."""
    return f"{getattr(fit.lens, fit.names[0]):.2f} ± {fit.deviations[0]:.2f}"


def rendered(name: str, count: int) -> tuple[str, ...]:
    """The row of one device's front camera."""
    from tests.support.boards import held

    device = read_device(name)
    camera = device.cameras[0]
    poses = held(camera, BOARD, count, np.random.default_rng(0), tilt=TILT)
    photos = [Photo(str(k), picture(device, pose)) for k, pose in enumerate(poses)]
    views, missed = find_views(photos, BOARD)
    kind = FITTED.get(camera.lens.kind, camera.lens.kind)
    size = (camera.width, camera.height)
    fit = calibrate(views, BOARD, size, kind, circle_px=camera.image_circle_px)
    true = getattr(camera.lens, fit.names[0], None) or camera.lens.focal  # type: ignore[attr-defined]
    off = getattr(fit.lens, fit.names[0]) / true - 1.0
    found = f"{len(views)} of {len(views) + len(missed)}"
    aside = np.hypot(fit.lens.cx - camera.lens.cx, fit.lens.cy - camera.lens.cy)
    lens = f"{camera.lens.kind}, {true:.2f} px"
    return (name, lens, found, *errors(fit), focal(fit), f"{100 * off:+.3f} %", f"{aside:.2f} px")


def picture(device: Device, T_camera_board: np.ndarray) -> np.ndarray:
    """A board before the front camera under its LEDs, as sRGB, exposed so that paper is bright."""
    from tests.support.shapes import make_organ

    camera = device.cameras[0]
    span = BOARD.columns + 2 * MARGIN, BOARD.rows + 2 * MARGIN
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    flat = (corners * span - (MARGIN + 1)) * BOARD.square
    vertices = transform_points(T_camera_board, np.column_stack([flat, np.zeros(4)]))
    faces = np.array([[0, 2, 1], [0, 3, 2]])
    organ = make_organ(vertices, faces, uv=corners[faces], appearance=paper(*span))
    state = State(0.0, invert(camera.T_capsule_camera))
    renderer = Renderer(
        Model(organ, device, np.eye(4)), RenderSettings(light="direct", supersampling=4)
    )
    radiance = renderer.render(state, camera, channels=("radiance",)).radiance
    assert radiance is not None
    return _core.encode_srgb(radiance, 0.8 / float(np.quantile(radiance.max(axis=2), 0.98)))


def paper(columns: int, rows: int) -> Appearance:
    """White matt paper with the board in its middle."""
    row, column = np.indices((rows, columns))
    inside = (column >= MARGIN) & (column < columns - MARGIN)
    inside &= (row >= MARGIN) & (row < rows - MARGIN)
    ink = inside & ((row + column) % 2 == 0)
    squares = np.where(ink, 50, 230).astype(np.uint8)
    albedo = np.repeat(np.repeat(squares, TEXELS, axis=0), TEXELS, axis=1)
    rough, height = np.full(albedo.shape, 255, np.uint8), np.zeros(albedo.shape)
    return Appearance(np.stack([albedo] * 3, axis=-1), rough, height, ior=1.0001, clearcoat=0.0)


HEAD_PHOTOS = (
    *("photographs", "board found in", "model", "mean error [px]", "RMS [px]"),
    *("published mean [px]", "focal length [px]"),
)
HEAD_RENDERED = (
    *("device", "its lens", "board found in", "mean error [px]", "RMS [px]"),
    *("focal length found [px]", "off by", "center off by"),
)
TEXT = """## Photographs and rendered boards

Real photographs, compared with the fits published with them (MATLAB's pinhole and fisheye models):

{photos}

Boards of {columns} × {rows} squares of 2 mm, rendered by the catalog's front cameras under their
own LEDs with 16 rays per pixel, turned out of the image plane by up to {tilt:.0f}° about each axis.
Boards whose squares are a few pixels wide are not found. Claimed: focal length within 0.5 %.

{rendered}
"""


def main() -> None:
    """Fit, compare, write the tables."""
    given = options(__doc__ or "", 12)
    page = PAGE if given.out.name == "validation.md" else Path(given.out)
    rows = [rendered(name, given.size) for name in DEVICES]
    text = TEXT.format(
        photos=table(HEAD_PHOTOS, photographs()),
        rendered=table(HEAD_RENDERED, rows),
        **{"columns": BOARD.columns, "rows": BOARD.rows, "tilt": TILT / DEG},
    )
    write_section(page, Path(__file__), text, title="")


if __name__ == "__main__":
    main()
