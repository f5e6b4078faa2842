from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from vrcaps.core.color import LUMINANCE, log_linear_from_srgb, srgb_from_log_linear
from vrcaps.core.errors import InputError
from vrcaps.mucosa.texture import HEAD, read_texture, texture_sha256, write_texture
from vrcaps.tools.mucosa_from_photos.patches import PhotoScale
from vrcaps.tools.mucosa_from_photos.texture import TextureOptions, make_texture, write_report
from vrcaps.tools.photos import Photo, read_photos

SCALE = PhotoScale(mm_per_pixel=0.1)


def photo(seed: int = 0, side: int = 200) -> Photo:
    """A round field of mottled mucosa under a lamp, with highlights and a vessel."""
    rng = np.random.default_rng(seed)
    mottle = ndimage.gaussian_filter(rng.normal(size=(side, side, 3)), (1.5, 1.5, 0.0))
    y, x = np.mgrid[:side, :side] - side / 2
    light = 1.0 - 0.5 * (np.hypot(x, y) / (0.5 * side)) ** 2
    image = np.array([0.6, 0.2, 0.13]) * np.exp(0.4 * mottle) * light[..., None]
    image *= np.exp(-0.4 * np.exp(-0.5 * ((y - 20 * np.sin(x / 30)) / 1.5) ** 2))[
        ..., None
    ] ** np.array([0.2, 1.0, 0.8])
    rgb = srgb_from_log_linear(np.log(np.maximum(image, 1e-4)).astype(np.float32))
    for row, column in rng.integers(60, 140, (8, 2)):
        rgb[row : row + 3, column : column + 3] = 255
    rgb[np.hypot(x, y) > 0.48 * side] = 0
    return Photo(f"photo-{seed}.png", rgb)


@pytest.fixture(scope="module")
def work():
    options = TextureOptions(size=256)
    return make_texture([photo(0), photo(1)], SCALE, options, seed=5)


@pytest.mark.slow
def test_the_texture_has_its_size_scale_and_luminance(work) -> None:
    texture = work.texture
    assert texture.albedo.shape == (256, 256, 3)
    assert texture.texel == pytest.approx(1e-4)
    assert texture.side == pytest.approx(0.0256)
    luminance = np.exp(log_linear_from_srgb(texture.albedo)) @ LUMINANCE
    assert luminance.mean() == pytest.approx(0.30, abs=0.03)


def test_the_measures_hold(work) -> None:
    """Seams, color, detail, repetition and highlights, against the regions."""
    measures = work.texture.metadata["measures"]
    assert measures["seam_ratio"] == pytest.approx(1.0, abs=0.15)
    assert measures["lab_mean_texture"] == pytest.approx(measures["lab_mean_source"], abs=1.0)
    assert measures["lab_std_texture"] == pytest.approx(measures["lab_std_source"], rel=0.2)
    assert measures["gradient_distance"] < 0.05
    assert measures["repetition"] < 0.25
    assert measures["highlight_fraction"] < 0.005


def test_the_relief_has_the_slope_stated(work) -> None:
    from vrcaps.tools.mucosa_from_photos.texture import RELIEF_SLOPE

    height = work.texture.relief
    slope = np.hypot(*(np.roll(height, -1, axis) - height for axis in (0, 1))) / 1e-4
    assert np.sqrt(np.mean(slope**2)) == pytest.approx(RELIEF_SLOPE, rel=0.02)


@pytest.mark.slow
def test_a_seed_gives_the_same_files(work, tmp_path: Path) -> None:
    options = TextureOptions(size=256)
    again = make_texture([photo(0), photo(1)], SCALE, options, seed=5)
    for name, made in (("a", work), ("b", again)):
        write_texture(tmp_path / name, made.texture)
    for file in (tmp_path / "a").iterdir():
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes()


@pytest.mark.slow
def test_a_texture_reads_back_as_written(work, tmp_path: Path) -> None:
    write_texture(tmp_path / "t", work.texture)
    write_report(tmp_path / "t" / "report.png", work)
    for path in (tmp_path / "t", tmp_path / "t" / HEAD):
        back = read_texture(path)
        np.testing.assert_array_equal(back.albedo, work.texture.albedo)
        np.testing.assert_array_equal(back.roughness, work.texture.roughness)
        np.testing.assert_array_equal(back.height, work.texture.height)
        assert back.texel == pytest.approx(work.texture.texel)
    assert len(texture_sha256(tmp_path / "t")) == 64
    write_texture(tmp_path / "t", work.texture)  # a texture may be replaced


@pytest.mark.slow
def test_a_field_width_is_a_scale(work) -> None:
    made = make_texture([photo(0)], PhotoScale(field_width_mm=20), TextureOptions(size=256), seed=0)
    width = made.sources[0].view.width
    assert made.texture.texel == pytest.approx(0.020 / width)


def test_a_flat_picture_is_taken_as_it_is() -> None:
    rgb = photo(0).rgb[60:140, 60:140]
    made = make_texture([Photo("flat", rgb)], SCALE, TextureOptions(size=256, is_flat=True), seed=0)
    assert made.sources[0].view.usable.all()


@pytest.mark.parametrize(
    ("photos", "scale", "options", "match"),
    [
        ([photo()], PhotoScale(), TextureOptions(), "does not say its scale"),
        ([photo()], PhotoScale(0.1, 30.0), TextureOptions(), "Give one of"),
        ([photo()], PhotoScale(-1.0), TextureOptions(), "The scale is"),
        ([photo(side=400)], SCALE, TextureOptions(size=128), r"The size is 128\. Allowed: \d+ or"),
        ([photo(side=40)], SCALE, TextureOptions(), "too few to make a texture from"),
        ([photo(), photo(1)], SCALE, TextureOptions(box=(9, 9, 60, 60)), "one photograph"),
        (
            [Photo("dark", np.zeros((99, 99, 3), np.uint8))],
            SCALE,
            TextureOptions(),
            "No usable region in dark",
        ),
    ],
)
def test_what_cannot_be_made(photos, scale, options, match: str) -> None:
    with pytest.raises(InputError, match=match):
        make_texture(photos, scale, options, seed=0)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"size": 20}, r"TextureOptions' size is 20\. Allowed: 128 to 8192"),
        ({"max_sources": 0}, r"max_sources is 0\. Allowed: 1 or more"),
        ({"luminance": 2.0}, r"luminance is 2\.0\. Allowed: 0\.02 to 0\.8"),
        ({"box": 5}, r"box is 5\. Allowed: 4 whole numbers"),
    ],
)
def test_options_of_a_texture_have_limits(options, match: str) -> None:
    with pytest.raises(InputError, match=match):
        TextureOptions(**options)


def test_photographs_are_read_from_files_and_folders(tmp_path: Path) -> None:
    Image.fromarray(photo().rgb).save(tmp_path / "b.png")
    Image.fromarray(photo(1).rgb).save(tmp_path / "a.jpg")
    (tmp_path / "notes.txt").write_text("no picture")
    assert [read.name for read in read_photos([tmp_path])] == ["a.jpg", "b.png"]
    (read,) = read_photos([tmp_path / "b.png"])
    np.testing.assert_array_equal(read.rgb, photo().rgb)


def test_frames_are_read_from_a_video(tmp_path: Path) -> None:
    import av

    with av.open(str(tmp_path / "v.mp4"), "w") as container:
        stream = container.add_stream("mpeg4", rate=10)
        stream.width = stream.height = 64
        stream.pix_fmt = "yuv420p"
        for level in range(0, 200, 20):
            image = np.full((64, 64, 3), level, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())
    read = read_photos([tmp_path / "v.mp4"], num_frames=3)
    assert [frame.rgb.mean() for frame in read] == pytest.approx([0, 80, 180], abs=8)


def test_what_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.png").write_text("no picture")
    (tmp_path / "text.mp4").write_text("no video")
    for paths, match in (
        ([], "No photograph is given"),
        ([tmp_path / "empty"], "contains no photograph"),
        ([tmp_path / "gone.png"], "No file at"),
        ([tmp_path / "text.png"], "Cannot read"),
        ([tmp_path / "text.mp4"], "Cannot read the video"),
    ):
        with pytest.raises(InputError, match=match):
            read_photos(paths)
    with pytest.raises(InputError, match="1 or more"):
        read_photos([tmp_path], num_frames=0)


@pytest.mark.slow
def test_textures_that_cannot_be_read_or_written(work, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is not a mucosa texture"):
        read_texture(tmp_path)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").write_text("mine")
    with pytest.raises(InputError, match="is not a texture"):
        write_texture(tmp_path / "other", work.texture)
    folder = tmp_path / "t"
    write_texture(folder, work.texture)
    head = json.loads((folder / HEAD).read_text())
    for change, match in (
        ({"format": "other/1"}, "has format 'other/1'"),
        ({"mm_per_texel": -1.0}, "out of range"),
        ({"sha256": {}}, "is missing or not the picture"),
    ):
        (folder / HEAD).write_text(json.dumps(head | change))
        with pytest.raises(InputError, match=match):
            read_texture(folder)
    (folder / HEAD).write_text(json.dumps({"format": head["format"]}))
    with pytest.raises(InputError, match="lacks"):
        read_texture(folder)
    picture = next(folder.glob("*.png"))
    picture.write_bytes(b"no picture")
    digest = hashlib.sha256(b"no picture").hexdigest()
    head["sha256"][picture.name] = digest
    for text in ("{", json.dumps(head), "[" * 100_000):
        (folder / HEAD).write_text(text)
        with pytest.raises(InputError, match="Cannot read the texture"):
            read_texture(folder)
