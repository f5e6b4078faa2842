from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.units import MM
from vrcaps.mesh.mesh import vertex_normals
from vrcaps.mucosa.apply_texture import apply_texture
from vrcaps.mucosa.bake import bake_appearance
from vrcaps.mucosa.mucosa import is_texture_path, mucosa_fingerprint
from vrcaps.mucosa.texture import MucosaTexture, write_texture
from vrcaps.organ.surface import Centerline, OrganSurface
from vrcaps.organ.uv import tube_coordinates


def tube(radius: float = 20.0 * MM, length: float = 120.0 * MM) -> OrganSurface:
    """A round tube of 2 mm edges along x, normals to its axis."""
    rings, spokes = 61, 62
    along, angle = np.meshgrid(
        np.linspace(0.0, length, rings),
        np.linspace(-np.pi, np.pi, spokes, endpoint=False),
        indexing="ij",
    )
    vertices = np.stack([along, radius * np.cos(angle), radius * np.sin(angle)], axis=2)
    number = np.arange(rings * spokes).reshape(rings, spokes)
    a, b = number[:-1], number[1:]
    c, d = np.roll(a, -1, axis=1), np.roll(b, -1, axis=1)
    faces = np.concatenate(
        [np.stack(part, axis=2).reshape(-1, 3) for part in ((a, c, b), (b, c, d))]
    )
    vertices = vertices.reshape(-1, 3)
    normals = vertex_normals(vertices, faces)
    if (normals[:, 1:] * vertices[:, 1:]).sum() > 0.0:
        faces, normals = faces[:, ::-1], -normals
    count = len(vertices)
    line = np.column_stack([np.linspace(0.0, length, 20), np.zeros(20), np.zeros(20)])
    return OrganSurface(
        name="tube",
        vertices=vertices,
        faces=np.ascontiguousarray(faces),
        normals=normals,
        uv=tube_coordinates(faces, along.ravel(), angle.ravel()),
        label=np.ones(count, np.uint8),
        label_names=("background", "wall"),
        instance=np.zeros(count, np.uint16),
        arc_length=along.ravel(),
        theta=angle.ravel(),
        radius=np.full(count, radius),
        centerline=Centerline(
            line, line[:, 0], np.full(20, radius), np.tile(np.eye(3), (20, 1, 1))
        ),
    )


def texture(side: int = 128) -> MucosaTexture:
    """Blobs about 1 mm wide at 4 texels per mm, with relief."""
    rng = np.random.default_rng(0)
    blobs = ndimage.gaussian_filter(rng.normal(size=(side, side)), 1.5, mode="wrap")
    blobs /= blobs.std()
    albedo = np.clip(np.array([200, 110, 90]) + 12.0 * blobs[..., None], 0, 255).astype(np.uint8)
    height = (32768 + 300 * blobs).astype(np.uint16)
    roughness = np.clip(165 + 8 * blobs, 0, 255).astype(np.uint8)
    return MucosaTexture(albedo, roughness, height, texel=0.25 * MM)


@pytest.fixture(scope="module")
def textured():
    return apply_texture(tube(), texture(), (480, 504), seed=1)


@pytest.mark.slow
def test_color_contrast_and_relief_stay(textured) -> None:
    """The blend keeps mean and spread, so neither patches nor their borders are paler."""
    given = texture()
    mean = given.albedo.mean(axis=(0, 1))
    np.testing.assert_allclose(textured.albedo.mean(axis=(0, 1)), mean, rtol=0.03)
    detail = textured.albedo[..., 0] - ndimage.gaussian_filter(
        textured.albedo[..., 0].astype(float), 25
    )
    assert detail.std() == pytest.approx(12.0, rel=0.15)
    assert textured.height.std() == pytest.approx(given.relief.std(), rel=0.15)
    assert textured.roughness.mean() == pytest.approx(165.0, abs=2.0)


@pytest.mark.slow
def test_no_seam_where_the_texture_coordinates_wrap(textured) -> None:
    """The step from the last column to the first is that between inner columns."""
    image = textured.albedo[10:-10].astype(float)
    inner = np.abs(np.diff(image, axis=1)).mean()
    seam = np.abs(image[:, 0] - image[:, -1]).mean()
    assert seam == pytest.approx(inner, rel=0.25)


@pytest.mark.slow
def test_no_repetition_although_the_texture_fits_many_times(textured) -> None:
    """A plain tiling has an autocorrelation of 1 at a shift of one tile, 32 mm."""
    from vrcaps.tools.mucosa_from_photos.quilt import repetition

    image = textured.albedo[:480, :480, 0].astype(float)
    image -= ndimage.gaussian_filter(image, 25)
    assert repetition(image, reach=48) < 0.3


def test_the_scale_is_that_of_the_texture(textured) -> None:
    """Blobs are as wide on the wall as in the texture: 4 texels per mm in both."""
    steps = [
        np.abs(np.diff(image[..., 0].astype(float), axis=axis)).mean()
        for image in (texture().albedo, textured.albedo[20:-20])
        for axis in (0, 1)
    ]
    assert np.mean(steps[2:]) == pytest.approx(np.mean(steps[:2]), rel=0.2)


@pytest.mark.slow
def test_a_seed_gives_the_same_bytes(textured) -> None:
    again = apply_texture(tube(), texture(), (480, 504), seed=1)
    other = apply_texture(tube(), texture(), (480, 504), seed=2)
    assert again.albedo.tobytes() == textured.albedo.tobytes()
    assert again.height.tobytes() == textured.height.tobytes()
    assert other.albedo.tobytes() != textured.albedo.tobytes()


@pytest.mark.slow
def test_baking_takes_the_path_of_a_texture(tmp_path) -> None:
    write_texture(tmp_path / "mine", texture())
    organ = tube()
    look = bake_appearance(organ, seed=1, mucosa=str(tmp_path / "mine"), texels_per_mm=4.0)
    assert look.clearcoat_gloss == 0.93
    # The slow variation has a standard deviation of 3 % in red.
    assert look.albedo[..., 0].mean() == pytest.approx(200.0, rel=0.04)
    assert replace(organ, appearance=look).appearance is look


def test_names_and_paths_of_mucosae(tmp_path) -> None:
    write_texture(tmp_path / "mine", texture())
    assert not is_texture_path("stomach")
    assert is_texture_path(str(tmp_path / "mine"))
    assert mucosa_fingerprint(None) == {}
    assert mucosa_fingerprint("colon") == {"mucosa": "colon"}
    assert len(mucosa_fingerprint(str(tmp_path / "mine"))["mucosa"]) == 64
    with pytest.raises(UnknownNameError, match="No mucosa named 'collon'"):
        is_texture_path("collon")
    with pytest.raises(InputError, match="is not a mucosa texture"):
        mucosa_fingerprint(str(tmp_path / "other"))
