"""Data of others: names that they state do not lead elsewhere, and hidden files are not read."""

import json
import os
import shutil
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import vrcaps
from tests.support.ellipsoid_sequence import ellipsoid_sequence
from vrcaps.camera.lens import LensPinhole
from vrcaps.core.errors import InputError, VrcapsError
from vrcaps.formats.format import FORMATS
from vrcaps.formats.io import export, read_format

PLAIN = [k for k in FORMATS if k not in ("coco", "bop", "lerobot", "mcap", "minari")]
"""Formats that hold frames and no lesions."""
APPLE = b"\0\5\x16\7\0\2\0\0Mac OS X        "


@pytest.fixture(scope="module")
def sequence():
    lens = LensPinhole(fx=25.0, fy=24.0, cx=20.25, cy=17.5)
    return ellipsoid_sequence(lens, 40, 36, frames=2)


@pytest.fixture(scope="module")
def exported(sequence, tmp_path_factory):
    """A folder of each format."""
    place = tmp_path_factory.mktemp("exported")
    return {kind: export(FORMATS[kind](), [sequence], place / kind) for kind in PLAIN}


@pytest.mark.parametrize("kind", PLAIN)
def test_files_of_macos_and_windows_change_nothing(kind, exported, tmp_path):
    """A `._` file beside each file, and a thumbnail in each folder."""
    folder = shutil.copytree(exported[kind], tmp_path / "copy")
    for path in [*folder.rglob("*")]:
        if path.is_file():
            path.with_name(f"._{path.name}").write_bytes(APPLE)
        else:
            (path / "Thumbs.db").write_bytes(b"\xd0\xcf")
            (path / ".DS_Store").write_bytes(b"\0")
    before, found = read_format(kind, exported[kind]), read_format(kind, folder)
    assert [len(one) for one in found] == [len(one) for one in before]
    for mine, theirs in zip(found, before, strict=True):
        np.testing.assert_array_equal(mine.image("rgb", 1), theirs.image("rgb", 1))


@pytest.mark.parametrize("kind", PLAIN)
def test_links_out_of_the_folder_are_not_followed(kind, exported, tmp_path):
    folder = shutil.copytree(exported[kind], tmp_path / "copy")
    path = max((p for p in folder.rglob("*") if p.is_file()), key=lambda p: p.stat().st_size)
    shutil.move(path, tmp_path / "elsewhere")
    os.symlink(tmp_path / "elsewhere", path)
    with pytest.raises(InputError, match=f"{path.name} leads out of .*copy"):
        read_format(kind, folder)


def _replaced(path, before, after):
    text = path.read_text()
    assert before in text
    path.write_text(text.replace(before, after))


@pytest.mark.parametrize(
    ("kind", "file", "stated"),
    [
        ("tum", "ball_front/rgb.txt", "rgb/000000.png"),
        ("euroc", "ball_front/mav0/cam0/data.csv", "500000000.png"),
        ("vslam-lab", "ball_front/rgb.csv", "rgb_0/000000.png"),
        ("colmap", "ball_front/sparse/0/images.txt", "rig1/front/image000001.png"),
        ("nerfstudio", "ball_front/transforms.json", "images/front/frame_000001.png"),
    ],
)
@pytest.mark.parametrize("name", ["../../../secret.png", "{absolute}"])
def test_files_that_data_name_lie_in_their_folder(kind, file, stated, name, exported, tmp_path):
    folder = shutil.copytree(exported[kind], tmp_path / "a/b/copy")
    Image.new("RGB", (40, 36)).save(tmp_path / "secret.png")
    _replaced(folder / file, stated, name.format(absolute=tmp_path / "secret.png"))
    with pytest.raises(InputError, match=r"leads out of|name is|No such file"):
        read_format(kind, folder)[0].image("rgb", 0)


@pytest.mark.parametrize("kind", ["kitti", "simcol3d"])
def test_names_in_a_list_are_no_paths(kind, exported, tmp_path):
    folder = shutil.copytree(exported[kind], tmp_path / "copy")
    path = folder / "sequences.json"
    rows = json.loads(path.read_text())
    for change, message in (
        ({"name": "../../x"}, "The name of a sequence is '../../x'"),
        ({"split": "../x"}, "No split of"),
        ({"load": "os:abort"}, "unknown key"),
        ({"name": 5}, "is 5. Allowed: a string"),
    ):
        path.write_text(json.dumps({place: row | change for place, row in rows.items()}))
        with pytest.raises(VrcapsError, match=message):
            read_format(kind, folder)


def _coco(folder, **image):
    (folder / "annotations").mkdir(parents=True)
    (folder / "images").mkdir()
    Image.new("RGB", (64, 64)).save(folder / "images/a.png")
    row = {"id": 1, "file_name": "a.png", "height": 64, "width": 64, **image}
    table = {"categories": [{"id": 1, "name": "polyp"}], "annotations": [], "images": [row]}
    (folder / "annotations/instances_default.json").write_text(json.dumps(table))
    return folder


@pytest.mark.parametrize("name", ["../../escaped/.config/autostart", "/tmp/x", "..", ["a"], 7, ""])
def test_a_sequence_of_coco_is_no_path(tmp_path, name):
    with pytest.raises(VrcapsError):
        read_format("coco", _coco(tmp_path / "coco", sequence=name))


def test_an_image_of_coco_lies_in_the_folder(tmp_path):
    Image.new("RGB", (64, 64)).save(tmp_path / "secret.png")
    (found,) = read_format("coco", _coco(tmp_path / "coco", file_name="../../secret.png"))
    with pytest.raises(InputError, match="leads out of"):
        found.image("rgb", 0)
    (found,) = read_format("coco", _coco(tmp_path / "large", width=10**6, height=10**6))
    with pytest.raises(InputError, match="declares 1000000 x 1000000 pixels"):
        found.image("label", 0)


@pytest.mark.parametrize("kind", PLAIN)
def test_two_sequences_with_one_folder_are_one_line(kind, sequence, tmp_path):
    """`a/b` and `a_b` would have the same folder."""
    other = replace(sequence, name="ball_front")
    numbered = ("kitti", "simcol3d", "images")
    if kind in numbered:
        return
    with pytest.raises(InputError, match=r"require the folder|have the same names"):
        export(FORMATS[kind](), [sequence, other], tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_frames_that_do_not_rise_in_time_are_refused(exported, tmp_path):
    folder = shutil.copytree(exported["kitti"], tmp_path / "copy")
    (folder / "sequences/00/times.txt").write_text("1.0\n1.0\n")
    with pytest.raises(InputError, match=r"frame 1 at 1 s does not come after frame 0 at 1 s"):
        read_format("kitti", folder)


def test_a_trajectory_of_another_layout_is_refused(exported, tmp_path):
    folder = shutil.copytree(exported["tum"], tmp_path / "tum")
    truth = folder / "ball_front/groundtruth.txt"
    truth.write_text(truth.read_text().replace(" ", ","))
    with pytest.raises(InputError, match=r"is not in the layout TUM: it has commas.*'euroc'"):
        read_format("tum", folder)
    folder = shutil.copytree(exported["vslam-lab"], tmp_path / "vslam")
    _replaced(folder / "ball_front/groundtruth.csv", "qx,qy,qz,qw", "qw,qx,qy,qz")
    with pytest.raises(InputError, match=r"quaternions in the order wxyz\. Allowed: xyzw"):
        read_format("vslam-lab", folder)


def test_the_folder_where_one_is_has_a_name(exported, monkeypatch):
    monkeypatch.chdir(exported["tum"] / "ball_front")
    assert vrcaps.read_format("tum", ".")[0].name == "ball_front"


@pytest.mark.parametrize(
    ("counts", "message"),
    [
        ([10**15], "do not add up to 4096 pixels"),
        ([5000, -904], "do not add up"),
        ("o" * 100_000, "too many digits"),
        (None, "cannot be read"),
    ],
)
def test_runs_of_coco_are_as_long_as_the_image(tmp_path, counts, message):
    """Before memory is taken, and without work that grows with the square of the text."""
    folder = _coco(tmp_path / "coco")
    path = folder / "annotations/instances_default.json"
    table = json.loads(path.read_text())
    runs = {"size": [64, 64], "counts": counts}
    table["annotations"] = [{"id": 4, "image_id": 1, "category_id": 1, "segmentation": runs}]
    path.write_text(json.dumps(table))
    with pytest.raises(InputError, match=message):
        read_format("coco", folder)[0].image("label", 0)


def test_values_of_yaml_are_shown_in_short(exported, tmp_path):
    """Anchors of YAML stand for lists of lists, 9^9 items in a few lines."""
    folder = shutil.copytree(exported["euroc"], tmp_path / "copy")
    path = folder / "ball_front/mav0/cam0/sensor.yaml"
    lists = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lists += [f"a{k + 1}: &a{k + 1} [{', '.join([f'*a{k}'] * 9)}]" for k in range(9)]
    text = path.read_text().replace("intrinsics: [", "intrinsics: [*a9, ")
    path.write_text("\n".join([*lists, text]))
    with pytest.raises(InputError, match="for intrinsics") as error:
        read_format("euroc", folder)
    assert len(str(error.value)) < 1000


def test_a_time_of_tum_is_finite(exported, tmp_path):
    folder = shutil.copytree(exported["tum"], tmp_path / "copy")
    _replaced(folder / "ball_front/rgb.txt", "0.500000000", "nan")
    with pytest.raises(InputError, match=r"time of rgb/000000\.png is nan"):
        read_format("tum", folder)


def test_damaged_parquet_and_films_are_one_line(tmp_path, sequence):
    out = export(FORMATS["hugging-face"](), [sequence], tmp_path / "out")
    (path,) = (out / "data").glob("*.parquet")
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(InputError, match=r"Cannot read .*\.parquet"):
        read_format("hugging-face", out)
