"""COCO: pycocotools decodes the masks and measures the areas and boxes that we write."""

import json
import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pycocotools.mask as coco_mask
import pytest
from scipy import ndimage

from tests.support.exported import assert_same_images
from vrcaps.cli import main
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.formats.detection.coco import Coco
from vrcaps.formats.detection.masks import mask_of, outlines, run_lengths
from vrcaps.formats.io import export
from vrcaps.recording.frame_sequence import TIME, FrameSequence


def lesion(number, kind, grade=None):
    return {"instance": number, "kind": kind, "grade": grade}


LESIONS = [lesion(1, "polyp", "Ip"), lesion(2, "colitis", "2"), lesion(3, "polyp", "IIa")]


def instances(index):
    """No lesion; a polyp behind a fold, in two parts; a ring of colitis around another polyp."""
    image = np.zeros((30, 40), np.uint16)
    if index == 1:
        image[4:12, 5:25] = 1
        image[:, 12:15] = 0
    if index == 2:
        rows, columns = np.indices(image.shape)
        radius = np.hypot(rows - 15, columns - 20)
        image[radius < 13] = 2
        image[radius < 6] = 3
        image[0, 39] = 7
    return image


def sequence_of(name="a/front", split=None, lesions=LESIONS):
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 256, (3, 30, 40, 3), np.uint8)
    channels = {"rgb": lambda k: rgb[k], "instance": instances}
    episode = SimpleNamespace(name=name, head={"organ": {"lesions": lesions}})
    return FrameSequence(
        name,
        ("rgb", "instance"),
        {TIME: np.array([0.5, 0.75, 1.0])},
        lambda channel, k: channels[channel](k),
        patient="p1",
        split=split,
        episode=episode,  # pyright: ignore[reportArgumentType]
    )


def decoded(row, shape):
    """Mask and area by pycocotools."""
    given = row["segmentation"]
    runs = coco_mask.frPyObjects(given, *shape)
    runs = coco_mask.merge(runs) if isinstance(given, list) else runs
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of NumPy, by pycocotools
        mask = coco_mask.decode(runs).astype(bool)
    return mask, int(coco_mask.area(runs)), coco_mask.toBbox(runs)


def test_any_mask_survives_as_polygons_and_as_runs():
    """Noise has all that can be: parts that touch at corners, holes in holes, single pixels."""
    rng = np.random.default_rng(0)
    for trial in range(60):
        shape = tuple(int(side) for side in rng.integers(1, 30, 2))
        smooth = ndimage.gaussian_filter(rng.random(shape), trial % 3)
        mask = smooth > np.quantile(smooth, rng.random() * 0.99)
        polygons = [polygon.ravel().tolist() for polygon in outlines(mask)]
        runs = json.loads(json.dumps(run_lengths(mask)))
        packed = coco_mask.frPyObjects(runs, *shape)
        for given in (polygons, runs):
            if mask.any():
                found, area, _ = decoded({"segmentation": given}, shape)
                np.testing.assert_array_equal(found, mask)
                assert area == mask.sum()
        for given in (polygons, runs, {"counts": packed["counts"].decode()}):
            np.testing.assert_array_equal(mask_of(given, *shape, "it"), mask)


@pytest.mark.parametrize("masks", ["polygons", "rle"])
def test_pycocotools_finds_our_areas_boxes_and_masks(masks, tmp_path):
    out = export(Coco(masks=masks), [sequence_of()], tmp_path / "out")
    content = json.loads((out / "annotations/instances_all.json").read_text())
    names = {each["id"]: each["name"] for each in content["categories"]}
    assert len(content["images"]) == 3  # the one without lesions too
    rows = content["annotations"]
    found = [(row["image_id"], row["instance"], names[row["category_id"]]) for row in rows]
    assert found == [(2, 1, "polyp"), (3, 2, "colitis"), (3, 3, "polyp"), (3, 7, "lesion")]
    for row in rows:
        mask = instances(row["image_id"] - 1) == row["instance"]
        theirs, area, box = decoded(row, mask.shape)
        np.testing.assert_array_equal(theirs, mask)
        assert area == row["area"] == mask.sum()
        np.testing.assert_array_equal(box, row["bbox"])
    if masks == "polygons":
        assert len(rows[0]["segmentation"]) == 2  # a fold lies before the polyp


def test_splits_have_a_file_each_with_the_same_categories(tmp_path):
    sequences = [sequence_of("a/front", "train"), sequence_of("b/front", "test", LESIONS[:1])]
    out = export(Coco(grades=True), sequences, tmp_path / "out")
    files = [
        json.loads((out / f"annotations/instances_{s}.json").read_text()) for s in ("train", "test")
    ]
    assert files[0]["categories"] == files[1]["categories"]
    names = [each["name"] for each in files[0]["categories"]]
    assert {"polyp-Ip", "polyp-IIa", "colitis-2", "lesion"} < set(names)
    assert len({image["id"] for file in files for image in file["images"]}) == 6
    assert len({row["id"] for file in files for row in file["annotations"]}) == 8
    assert all((out / "test" / each["file_name"]).exists() for each in files[1]["images"])


def test_crowds_are_runs_and_small_parts_can_be_left_out(tmp_path):
    form = Coco(crowd=("colitis",), min_area=2)
    out = export(form, [sequence_of()], tmp_path / "out")
    rows = json.loads((out / "annotations/instances_all.json").read_text())["annotations"]
    assert [(row["instance"], row["iscrowd"]) for row in rows] == [(1, 0), (2, 1), (3, 0)]
    assert isinstance(rows[1]["segmentation"], dict)
    with pytest.raises(UnknownNameError, match=r"No kind of lesion named 'polip'.*'polyp'"):
        Coco(crowd=("polip",))
    with pytest.raises(InputError, match="min_area is 0"):
        Coco(min_area=0)


@pytest.mark.parametrize("masks", ["polygons", "rle"])
def test_what_was_written_is_read(masks, tmp_path):
    sequence = sequence_of(split="val")
    out = export(Coco(masks=masks, crowd=("colitis",)), [sequence], tmp_path / "out")
    (found,) = Coco().read(out)
    assert (found.name, found.split, found.patient) == ("a/front", "val", "p1")
    np.testing.assert_array_equal(found.times, sequence.times)
    assert_same_images(found, sequence)
    assert_same_images(found, sequence, "instance")
    seen = found.image("label", 2)[instances(2) == 2]
    assert {found.label_names[number] for number in seen} == {"colitis"}


def test_images_of_others(tmp_path):
    """Names of years, polygons between pixels, one folder of images."""
    out = export(Coco(), [sequence_of()], tmp_path / "out")
    path = out / "annotations/instances_all.json"
    content = json.loads(path.read_text())
    for image in content["images"]:
        del image["sequence"], image["time_s"], image["patient"]
    square = [1.2, 1.2, 1.2, 4.2, 5.2, 4.2, 5.2, 1.2]
    row = {"id": 9, "image_id": 1, "category_id": 3, "segmentation": [square]}
    content["annotations"] = [row]
    path.unlink()
    (out / "annotations/instances_val2017.json").write_text(json.dumps(content))
    (found,) = Coco().read(out)
    assert (found.name, found.split, len(found)) == ("val2017", "val", 3)
    assert found.image("instance", 0).sum() == 12
    assert set(np.unique(found.image("label", 0))) == {0, 3}


def test_numbers_beyond_their_type_are_refused(tmp_path):
    """The 300th category is no label of 8 bits, an instance of 70,000 none of 16."""
    out = export(Coco(), [sequence_of()], tmp_path / "out")
    path = out / "annotations/instances_all.json"
    content = json.loads(path.read_text())
    content["categories"] = [{"id": k, "name": f"kind {k}"} for k in range(1, 301)]
    square = [1.2, 1.2, 1.2, 4.2, 5.2, 4.2, 5.2, 1.2]
    row = {"id": 9, "image_id": 1, "category_id": 300, "segmentation": [square]}
    content["annotations"] = [row | {"instance": 70_000}]
    path.write_text(json.dumps(content))
    (found,) = Coco().read(out)
    for channel, number in (("label", 300), ("instance", 70_000)):
        with pytest.raises(InputError, match=rf"{channel} values of .* the first is {number}\."):
            found.image(channel, 0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"annotations": [{"id": 1}]}, "contains no COCO instances: 'category_id' is missing"),
        ({"images": None}, "contains no COCO instances"),
    ],
)
def test_damaged_files(change, message, tmp_path):
    out = export(Coco(), [sequence_of()], tmp_path / "out")
    path = out / "annotations/instances_all.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(InputError, match=message):
        Coco().read(out)


def test_masks_that_do_not_fit():
    with pytest.raises(InputError, match="segmentation of annotation 4 cannot be read"):
        mask_of({"counts": [3, 4]}, 5, 5, "annotation 4")
    with pytest.raises(InputError, match="cannot be read"):
        mask_of([[1, 2, 3]], 5, 5, "annotation 4")
    with pytest.raises(InputError, match=r"contains no annotations/instances_\*.json"):
        Coco().read(Path("nowhere"))


def test_lesions_are_needed(tmp_path):
    sequence = replace(sequence_of(), channels=("rgb",))
    with pytest.raises(InputError, match="coco requires the channel 'instance'"):
        export(Coco(), [sequence], tmp_path / "out")


def test_command(pinhole_episode, tmp_path, capsys):
    arguments = ["export", "coco", str(pinhole_episode.path), "--out", str(tmp_path / "out")]
    main([*arguments, "--masks", "rle", "--crowd", "colitis", "bleeding"])
    assert "Wrote 1 sequence, 5 frames" in capsys.readouterr().out.replace("\n", " ")
    (found,) = Coco().read(tmp_path / "out")
    assert_same_images(found, pinhole_episode.sequence(), "instance")


def test_category_ids_are_those_of_earlier_exports(tmp_path):
    """All kinds of lesions have an ID, so that data sets can be combined."""
    kinds = "bleeding colitis polyp tumor diverticulum stricture erosion ulcer angioectasia"
    names = [*kinds.split(), "lymphangiectasia", "lesion"]
    out = export(Coco(), [sequence_of()], tmp_path / "out")
    content = json.loads((out / "annotations/instances_all.json").read_text())
    assert [(each["id"], each["name"]) for each in content["categories"]] == [*enumerate(names, 1)]
