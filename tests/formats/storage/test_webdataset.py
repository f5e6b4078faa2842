"""WebDataset: round trip, and what its own package reads."""

import io
import json
import tarfile
from dataclasses import replace

import numpy as np
import pytest

from vrcaps.core.errors import InputError
from vrcaps.core.files import files_in
from vrcaps.formats.io import export
from vrcaps.formats.storage.webdataset import WebDataset


def split_in_two(episode):
    """The episode as a sequence of two patients, with a dot in its names."""
    sequence = episode.sequence(channels=("rgb", "depth", "normal", "flow_backward", "occlusion"))
    return [
        replace(sequence, name=f"tube-{patient}.a/front", patient=str(patient), split=split)
        for patient, split in enumerate(("train", "test"))
    ]


def test_what_was_written_is_read(fisheye_episode, tmp_path):
    sequences = split_in_two(fisheye_episode)
    form = WebDataset(seed=3)
    found = form.read(export(form, sequences, tmp_path / "out"))
    assert {one.name: one.split for one in found} == {one.name: one.split for one in sequences}
    for sequence in sequences:
        (own,) = (one for one in found if one.name == sequence.name)
        assert (own.channels, own.camera, own.label_names, own.patient) == (
            *(sequence.channels, sequence.camera, sequence.label_names, sequence.patient),
        )
        for k, expected in enumerate(sequence):
            for name, values in expected.items():
                np.testing.assert_array_equal(own[k][name], values, err_msg=name)


def test_shards_are_of_the_stated_size_and_equal_bytes(fisheye_episode, tmp_path):
    sequences = split_in_two(fisheye_episode)
    outs = [export(WebDataset(0.03), sequences, tmp_path / name) for name in ("a", "b")]
    files = [[path.relative_to(out).as_posix() for path in files_in(out)] for out in outs]
    assert files[0] == files[1]
    assert {"train/000000.tar", "train/000001.tar", "test/000000.tar"} < {*files[0]}
    for name in files[0]:
        assert (outs[0] / name).read_bytes() == (outs[1] / name).read_bytes()
        assert (outs[0] / name).stat().st_size < 60e3
        with tarfile.open(outs[0] / name) as tar:
            assert {(m.mtime, m.uid, m.gid, m.uname) for m in tar} == {(0, 0, 0, "")}


@pytest.mark.slow
def test_its_own_package_reads_it(fisheye_episode, tmp_path):
    """Keys with a dot would fall apart: `tube-0.a` is written without."""
    import webdataset

    sequence = split_in_two(fisheye_episode)[0]
    out = export(WebDataset(), [sequence], tmp_path / "out")
    url = (out / "train/000000.tar").as_posix()
    samples = list(webdataset.WebDataset(url, shardshuffle=False, empty_check=False))
    assert [s["__key__"] for s in samples] == [f"tube-0-a_front_{k:06d}" for k in range(5)]
    about = json.loads(samples[2]["json"])
    np.testing.assert_array_equal(about["T_world_camera"], sequence.Ts_world_camera[2])
    depth = np.asarray(pillow(samples[2]["depth.png"])) * about["channels"]["depth"]["scale"]
    np.testing.assert_allclose(depth, np.nan_to_num(sequence.image("depth", 2)), atol=1e-8)
    np.testing.assert_array_equal(pillow(samples[2]["rgb.png"]), sequence.image("rgb", 2))


def pillow(data):
    from PIL import Image

    return Image.open(io.BytesIO(data))


def test_bad_folders_are_one_clear_line(fisheye_episode, tmp_path):
    with pytest.raises(InputError, match=r"contains no \.tar"):
        WebDataset().read(tmp_path)
    (tmp_path / "0.tar").write_bytes(b"no tar at all" * 99)
    with pytest.raises(InputError, match=r"Cannot read .*0\.tar"):
        WebDataset().read(tmp_path)
    for files, message in (
        ({"a.png": b""}, r"sample a has no \.json"),
        ({"a.json": b"{"}, r"a\.json is not JSON"),
        ({"a.json": b"{}"}, "lacks 'sequence'"),
    ):
        with tarfile.open(tmp_path / "0.tar", "w") as tar:
            for name, data in files.items():
                info = tarfile.TarInfo(name)
                info.size = len(data)
                tar.addfile(info, io.BytesIO(data))
        with pytest.raises(InputError, match=message):
            WebDataset().read(tmp_path)
    sequence = split_in_two(fisheye_episode)[0]
    with pytest.raises(InputError, match="have the same names"):
        export(WebDataset(), [sequence, replace(sequence, patient="2")], tmp_path / "out")
    with pytest.raises(InputError, match="shard_mb is 0"):
        WebDataset(shard_mb=0.0)


def test_a_damaged_image_is_one_clear_line(fisheye_episode, tmp_path):
    out = export(WebDataset(), split_in_two(fisheye_episode)[:1], tmp_path / "out")
    (sequence,) = WebDataset().read(out)
    shard = out / "train/000000.tar"
    shard.write_bytes(b"\0" * shard.stat().st_size)
    with pytest.raises(InputError, match=r"Cannot read the image at .*000000\.tar"):
        sequence.image("rgb", 0)
