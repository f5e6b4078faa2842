"""Rendered lesions in real images: exact masks, matched light, unchanged surroundings."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed")

from vrcaps.core.color import linear_from_srgb, luminance, srgb_from_linear  # noqa: E402
from vrcaps.core.errors import InputError, UnknownNameError  # noqa: E402
from vrcaps.formats.io import read_format  # noqa: E402
from vrcaps.learn.augment import (  # noqa: E402
    WALL as MUCOSA,
)
from vrcaps.learn.augment import (  # noqa: E402
    FluidFilm,
    fluid_film,
    hemorrhage,
    illumination_of,
    photographed,
)
from vrcaps.learn.compositing import (  # noqa: E402
    CompositeSettings,
    LesionPatch,
    composite,
    lesion_pairs,
    placed,
    quotient,
    rendered_patch,
    write_composites,
)
from vrcaps.learn.networks import Backbone  # noqa: E402
from vrcaps.learn.tasks.classification import ClassificationTask  # noqa: E402
from vrcaps.learn.tasks.segmentation import SegmentationTask  # noqa: E402
from vrcaps.recording.frame_sequence import FrameSequence  # noqa: E402

SIDE, COUNT = 64, 3
BLOOD = np.array([0.4, 0.1, 0.1])
WALL = np.array([150, 90, 70], np.uint8)


def disk(side: int = SIDE, radius: float = 14.0) -> np.ndarray:
    """Mask of a disk right of the center."""
    y, x = np.mgrid[:side, :side]
    return np.hypot(x - 0.55 * side, y - 0.5 * side) < radius


def patch(side: int = SIDE) -> LesionPatch:
    """Disk that passes 40 % of the red light and 10 % of the rest."""
    mask = disk(side)
    wall = linear_from_srgb(WALL)
    return LesionPatch(np.where(mask[..., None], BLOOD, 1.0), mask, "bleeding", wall)


def view(side: int = SIDE, color: np.ndarray = WALL, seed: int | None = None) -> np.ndarray:
    """Round picture on black: one color, or mottled."""
    y, x = np.mgrid[:side, :side]
    image = np.broadcast_to(color, (side, side, 3)).astype(float)
    if seed is not None:
        image = image * np.random.default_rng(seed).uniform(0.6, 1.2, (side, side, 1))
    inside = np.hypot(x - 0.5 * side + 0.5, y - 0.5 * side + 0.5) < 0.48 * side
    return np.where(inside[..., None], image, 0).clip(0, 255).astype(np.uint8)


def loaded(is_clean: bool, channel: str, index: int) -> np.ndarray:
    """Radiance and instances of a rendered view that looks at a disk of blood in its wall."""
    mask = np.roll(disk(), 3 * index, axis=0) if index < COUNT - 1 else np.zeros((SIDE, SIDE), bool)
    if channel == "instance":
        return np.where(mask & (not is_clean), 2, 0).astype(np.uint16)
    light = 7.0 + np.hypot(*np.mgrid[:SIDE, :SIDE])[..., None] * [1.0, 0.5, 0.3]
    return (light * (1.0 if is_clean else np.where(mask[..., None], BLOOD, 1.0))).astype(np.float32)


def recording(is_clean: bool, **changes) -> FrameSequence:
    """A recording, or its clean twin, without files."""
    lesions = [{"instance": 1, "kind": "polyp"}, {"instance": 2, "kind": "bleeding"}]
    head = {"scenario": {"seed": 4, "clean_twin": is_clean}, "organ": {"lesions": lesions}}
    values = {"time": np.arange(COUNT, dtype=float)}
    one = FrameSequence(
        f"episodes/{'clean' if is_clean else 'sick'}/front",
        ("radiance", "instance"),
        values,
        partial(loaded, is_clean),
        episode=SimpleNamespace(head=head),
    )
    return replace(one, **changes)


def photos(count: int = 4, color: np.ndarray = WALL) -> FrameSequence:
    """Images without lesions, from a folder of any source."""
    values = {"time": np.arange(count, dtype=float)}
    images = [view(color=color, seed=k) for k in range(count)]
    return FrameSequence("photos", ("rgb",), values, lambda _, index: images[index])


@pytest.mark.parametrize("seed", range(4))
def test_the_surroundings_are_unchanged_and_the_mask_is_exact(seed):
    image = view(seed=seed)
    moved = placed(patch(), SIDE, SIDE, np.random.default_rng(seed))
    made, mask = composite(image, moved)
    shown = np.hypot(*(np.mgrid[:SIDE, :SIDE] - 31.5)) < 0.48 * SIDE
    assert np.array_equal(mask, moved.mask & shown)
    assert np.array_equal(made[~mask], image[~mask])
    assert (made[mask].astype(int).sum() < 0.9 * image[mask].astype(int).sum()) == mask.any()


def test_one_color_becomes_that_color_times_the_quotient():
    """The fade at the outline is narrower than a pixel in a small image."""
    image = view()
    made, mask = composite(image, patch())
    expected = srgb_from_linear(linear_from_srgb(WALL) * BLOOD).astype(int)
    assert np.abs(made[mask].astype(int) - expected).max() <= 1
    assert np.array_equal(
        composite(image, replace(patch(), ratio=np.ones((SIDE, SIDE, 3))))[0], image
    )


def test_the_lesion_has_the_light_of_the_image():
    bright, dark = view(), srgb_from_linear(0.25 * linear_from_srgb(view()))
    (high, mask), (low, _) = composite(bright, patch()), composite(dark, patch())
    part = linear_from_srgb(low)[mask] / np.maximum(linear_from_srgb(high)[mask], 1e-9)
    assert part[:, 0] == pytest.approx(0.25, abs=0.03)


def test_an_opaque_lesion_keeps_its_hue_on_a_wall_of_another_color():
    yellow = view(color=np.array([150, 120, 30], np.uint8))
    ratio = np.where(disk()[..., None], [0.2, 0.02, 0.02], 1.0)
    opaque = replace(patch(), ratio=ratio)
    own, with_cast = (
        linear_from_srgb(composite(yellow, opaque, hue=hue)[0])[32, 36] for hue in (1.0, 0.0)
    )
    rendered = opaque.wall * ratio[32, 36]
    assert own[1] / own[2] == pytest.approx(rendered[1] / rendered[2], rel=0.25)
    assert with_cast[1] / with_cast[2] > 2.0 * own[1] / own[2]


def test_a_patch_of_a_black_view_has_no_hue():
    black = replace(patch(), wall=np.zeros(3))
    gray = replace(patch(), wall=np.ones(3))
    images = [composite(view(), one, hue=1.0)[0] for one in (black, gray)]
    assert np.array_equal(images[0], images[1])


def test_a_quotient_has_neither_light_nor_wall_of_the_renderer():
    found = rendered_patch(recording(False), recording(True), 1)
    assert found is not None
    assert found.kind == "bleeding"
    assert np.array_equal(found.mask, np.roll(disk(), 3, axis=0))
    assert found.ratio[found.mask] == pytest.approx(np.broadcast_to(BLOOD, (found.mask.sum(), 3)))
    assert found.ratio[~found.mask] == pytest.approx(1.0)
    assert rendered_patch(recording(False), recording(True), COUNT - 1) is None


def test_black_and_unknown_pixels_keep_a_quotient_of_one():
    clean = np.full((4, 4, 3), 2.0)
    clean[0, 0], clean[0, 1] = 0.0, np.nan
    ratio = quotient(np.full((4, 4, 3), 1e6), np.nan_to_num(clean))
    assert ratio[0, 0] == pytest.approx(1.0)
    assert ratio[1:].max() <= 2.0
    assert np.isfinite(quotient(np.ones((4, 4, 3)), np.nan_to_num(clean))).all()


@pytest.mark.parametrize("seed", range(6))
def test_a_moved_patch_carries_its_mask(seed):
    moved = placed(patch(96), 80, 100, np.random.default_rng(seed))
    assert moved.mask.shape == (80, 100)
    assert moved.mask.any()
    inside = moved.ratio[..., 1] < 0.3
    assert (inside & ~moved.mask).mean() < 0.01
    assert (moved.ratio[~moved.mask].min(axis=-1) > 0.25).all()


@pytest.mark.parametrize("seed", range(6))
def test_blood_is_marked_where_it_absorbs_half_of_the_green_light(seed):
    draw = np.random.default_rng(seed)
    blood = fluid_film(view(seed=seed), draw)
    assert np.array_equal(blood.mask, np.exp(-blood.density[..., 1]) < np.exp(-0.7))
    assert 0.0 < blood.mask.mean() <= 1.0
    assert (blood.density[..., 1] >= blood.density[..., 0]).all()
    assert blood.body[0] > max(blood.body[1], blood.body[2])
    for other in ("bile", "shadow", "murky"):
        assert not fluid_film(view(seed=seed), draw, other).mask.any()


def test_blood_differs_in_extent_and_thickness_from_veils_to_pools():
    films = [fluid_film(view(seed=k), np.random.default_rng(k)) for k in range(60)]
    areas = np.array([film.mask.mean() for film in films])
    thickest = np.array([film.density[..., 1].max() for film in films])
    assert (areas < 0.05).mean() > 0.1
    assert (areas > 0.3).mean() > 0.1
    assert thickest.min() < 1.0
    assert thickest.max() > 4.0


def test_fluid_pools_in_the_dark():
    """A third of the films follow the dark half of the image; the others ignore it."""
    image = view(color=np.array([220, 150, 130], np.uint8))
    image[: SIDE // 2] //= 4
    films = [fluid_film(image, np.random.default_rng(k)) for k in range(150)]
    above = np.array([film.density[: SIDE // 2].sum() for film in films])
    below = np.array([film.density[SIDE // 2 :].sum() for film in films])
    assert (above > below).mean() > 0.55


@pytest.mark.parametrize("seed", range(4))
def test_hemorrhagic_mucosa_is_red_with_spots_in_a_region(seed):
    image = view(color=np.array([200, 140, 120], np.uint8))
    film = hemorrhage(image, np.random.default_rng(seed))
    made = film.over(linear_from_srgb(image), illumination_of(image, 0.0))
    shown = film.mask & (image[..., 0] > 0)
    outside = ~film.mask & (image[..., 0] > 0)
    assert 0.02 < film.mask.mean() <= 1.0
    assert (made[shown, 1] / made[shown, 0]).mean() < 0.9 * (140 / 200) ** 2.2
    assert film.density[shown, 1].std() > 0.1
    assert film.density[outside, 1].max(initial=0.0) < film.density[shown, 1].max()


def test_a_thick_film_has_its_own_color_and_a_thin_one_that_of_the_wall():
    shape = (4, 6, 3)
    light, white = np.full(shape, 0.3), np.full(shape, 0.5)
    film = FluidFilm(np.array([0.08, 0.01, 0.01]), np.zeros(shape), np.zeros(shape[:2], bool))
    assert film.over(light, white) == pytest.approx(light)
    thick = replace(film, density=np.full(shape, 50.0))
    assert thick.over(light, white) == pytest.approx(np.broadcast_to(0.5 * film.body, shape))
    half = replace(film, density=np.full(shape, np.log(2.0)))
    assert half.over(light, white) == pytest.approx(0.5 * light + 0.25 * film.body)


def test_fresh_blood_is_brighter_than_dark_fluid_behind_it():
    """A quotient could only darken it."""
    shape = (4, 6, 3)
    nothing = np.zeros(shape[:2], bool)
    white = np.full(shape, 1.0)
    dark = FluidFilm(np.array([0.02, 0.02, 0.03]), np.full(shape, 50.0), nothing)
    blood = FluidFilm(np.array([0.15, 0.01, 0.01]), np.full(shape, 50.0), nothing)
    behind = dark.over(np.full(shape, 0.4), white)
    assert (blood.over(behind, white)[..., 0] > 5.0 * behind[..., 0]).all()


def test_illumination_is_the_image_over_the_wall_without_texture():
    plain, mottled = view(), view(seed=1)
    level, rough = illumination_of(plain, 1.0), illumination_of(mottled, 1.0)
    center = slice(20, 44), slice(20, 44)
    expected = luminance(linear_from_srgb(WALL)) / luminance(MUCOSA)
    assert level[center] == pytest.approx(expected, rel=0.02)
    deviation = luminance(linear_from_srgb(mottled))[center].std()
    assert luminance(rough)[center].std() * luminance(MUCOSA) < 0.5 * deviation
    cast = illumination_of(view(color=np.array([90, 90, 150], np.uint8)), 0.0)[32, 32]
    assert cast[2] > 3.0 * cast[0]
    assert np.isfinite(illumination_of(np.zeros((8, 8, 3), np.uint8), 0.5)).all()


def test_a_camera_changes_the_picture_but_not_its_surroundings():
    image = view(seed=2)
    light = 0.2 * linear_from_srgb(image)
    made = [photographed(light, image, np.random.default_rng(k)) for k in range(40)]
    outside = image.max(axis=-1) == 0
    assert all(np.array_equal(one[outside], image[outside]) for one in made)
    means = np.array([linear_from_srgb(one).mean() for one in made])
    assert means.min() < 0.5 * linear_from_srgb(image).mean()
    assert means.max() > linear_from_srgb(image).mean()
    sharp = np.array([np.abs(np.diff(one[30].astype(float), axis=0)).mean() for one in made])
    assert sharp.min() < 0.3 * np.median(sharp)
    black = np.zeros((8, 8, 3), np.uint8)
    assert np.array_equal(photographed(light[:8, :8], black, np.random.default_rng(0)), black)


def test_a_folder_of_composites_is_data_for_both_tasks(tmp_path):
    pairs = lesion_pairs([recording(False), recording(True)])
    settings = CompositeSettings(40, normal=0.3, fluid=0.3, seed=3)
    counts = write_composites(pairs, [photos()], tmp_path / "made", settings)
    assert sum(counts.values()) == 40
    assert min(counts["bleeding"], counts["normal"]) > 5
    sequences = read_format("images", tmp_path / "made")
    by_class = {str(one.values["class"][0]): one for one in sequences}
    assert {name: len(one) for name, one in by_class.items()} == counts
    task = SegmentationTask(backbone=Backbone(64))
    areas = {
        name: [(task.sample(one, k)["mask"] == 1).mean() for k in range(len(one))]
        for name, one in by_class.items()
    }
    assert max(areas["normal"]) == 0.0
    assert min(areas["bleeding"]) >= settings.min_fraction
    classes = ClassificationTask(("normal", "bleeding"), Backbone(64), min_fraction=0.0)
    assert all(len(list(classes.items(one))) == len(one) for one in sequences)


def test_the_same_arguments_give_the_same_files(tmp_path):
    pairs = lesion_pairs([recording(False), recording(True)])
    made = []
    for name, seed in (("first", 1), ("again", 1), ("other", 2)):
        write_composites(pairs, [photos()], tmp_path / name, CompositeSettings(6, seed=seed))
        files = sorted(path for path in (tmp_path / name).rglob("*.*"))
        made.append([path.read_bytes() for path in files])
    assert made[0] == made[1] != made[2]


def test_blood_is_the_kind_where_the_rendered_lesion_lies_outside(tmp_path, monkeypatch):
    def outside(one: LesionPatch, *_: object) -> LesionPatch:
        return replace(one, mask=np.zeros_like(one.mask))

    polyp = replace(patch(), kind="polyp")
    monkeypatch.setattr("vrcaps.learn.compositing.rendered_patch", lambda *_: polyp)
    pairs = lesion_pairs([recording(False), recording(True)])
    settings = CompositeSettings(24, normal=0.0, fluid=1.0)
    with monkeypatch.context() as patched:
        patched.setattr("vrcaps.learn.compositing.placed", outside)
        assert "polyp" not in write_composites(pairs, [photos()], tmp_path / "outside", settings)
    assert write_composites(pairs, [photos()], tmp_path / "inside", settings)["polyp"] > 0


def test_unsuitable_data_are_refused(tmp_path):
    with pytest.raises(InputError, match="No recording has a clean twin"):
        lesion_pairs([recording(False)])
    with pytest.raises(InputError, match="photos is not a recording"):
        lesion_pairs([photos()])
    twin = replace(recording(True), channels=("instance",))
    with pytest.raises(InputError, match="has no channel 'radiance'"):
        lesion_pairs([recording(False), twin])
    with pytest.raises(InputError, match="size of the patch"):
        composite(view(32), patch())
    for hue in (-0.1, 2.0, np.nan):
        with pytest.raises(InputError, match=r"hue is .*Allowed: 0 to 1"):
            composite(view(), patch(), hue=hue)
        with pytest.raises(InputError, match=r"hue is .*Allowed: 0 to 1"):
            illumination_of(view(), hue)
    with pytest.raises(UnknownNameError, match="No fluid named 'wine'"):
        fluid_film(view(), np.random.default_rng(0), "wine")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="count"):
        CompositeSettings(0)
    for pair, settings in (
        ((recording(False, load=partial(loaded, True)), recording(True)), CompositeSettings(4)),
        ((recording(False), recording(True)), CompositeSettings(4, min_fraction=1.0)),
    ):
        with pytest.raises(InputError, match=r"None of 3 views .* Allowed: 1 or more. Record more"):
            write_composites([pair], [photos()], tmp_path / "none", settings)
        assert not (tmp_path / "none").exists()
    with pytest.raises(InputError, match="0 views and 4 images"):
        write_composites([], [photos()], tmp_path / "none")
