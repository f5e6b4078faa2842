"""Hugging Face data sets: round trip, and what Arrow and their own package read."""

import io
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from PIL import Image

from vrcaps.core.errors import InputError
from vrcaps.core.files import files_in
from vrcaps.formats.io import export
from vrcaps.formats.storage.hugging_face import HuggingFace

CHANNELS = ("rgb", "depth", "normal", "label", "flow_backward", "occlusion")


@pytest.fixture
def sequences(fisheye_episode):
    """Two patients; the second has fewer channels and values, and nothing of its camera."""
    sequence = fisheye_episode.sequence(channels=CHANNELS)
    other = sequence.with_channels(["rgb", "label"])
    values = {"time": sequence.times}
    return [
        replace(sequence, patient="0", split="train"),
        replace(other, name="real", values=values, camera=None, split="train"),
        replace(sequence, name="tube-2/front", patient="2", split="test"),
    ]


def test_what_was_written_is_read(sequences, tmp_path):
    form = HuggingFace()
    found = form.read(export(form, sequences, tmp_path / "out"))
    assert {one.name: one.split for one in found} == {one.name: one.split for one in sequences}
    for sequence in sequences:
        (own,) = (one for one in found if one.name == sequence.name)
        assert (own.channels, own.camera, own.label_names, own.patient) == (
            *(sequence.channels, sequence.camera, sequence.label_names, sequence.patient),
        )
        for k, expected in enumerate(sequence):
            assert own[k].keys() == expected.keys()
            for name, values in expected.items():
                np.testing.assert_array_equal(own[k][name], values, err_msg=name)


def test_files_are_numbered_of_the_stated_size_and_equal_bytes(sequences, tmp_path):
    outs = [export(HuggingFace(0.03), sequences, tmp_path / name) for name in ("a", "b")]
    names = [[path.relative_to(out).as_posix() for path in files_in(out)] for out in outs]
    assert names[0] == names[1]
    count = sum(name.startswith("data/train-") for name in names[0])
    assert count > 1
    assert f"data/train-00001-of-{count:05d}.parquet" in names[0]
    for name in names[0]:
        assert (outs[0] / name).read_bytes() == (outs[1] / name).read_bytes()
    readme = (outs[0] / "README.md").read_text()
    start, header, body = readme.split("---\n", 2)
    read = yaml.safe_load(header)
    assert not start and "## Dataset Structure" in body
    assert read["size_categories"] == ["n<1K"]
    assert {"split": "test", "path": "data/test-*"} in read["configs"][0]["data_files"]
    assert (
        "| `depth` | z of the surface in the camera frame [m] | stored · 1e-05 + 0 | 0 |" in readme
    )


def test_arrow_reads_images_as_files(sequences, tmp_path):
    """Images that Pillow would cut to 8 bits are stored as plain bytes."""
    out = export(HuggingFace(), sequences, tmp_path / "out")
    table = pq.read_table(out / "data/train-00000-of-00001.parquet")
    row = table.slice(1, 1).to_pylist()[0]
    depth = np.asarray(Image.open(io.BytesIO(row["depth"]["bytes"]))) * 1e-5
    expected = np.nan_to_num(sequences[0].image("depth", 1))
    np.testing.assert_allclose(depth, expected, atol=1e-8)
    assert row["depth"]["path"].endswith("_000001.depth.png")
    assert isinstance(row["normal"], bytes)
    np.testing.assert_array_equal(row["T_world_camera"], sequences[0].Ts_world_camera[1])
    features = table.schema.metadata[b"huggingface"].decode()
    assert '"rgb": {"_type": "Image"}' in features
    assert '"normal": {"dtype": "binary", "_type": "Value"}' in features


@pytest.mark.slow
def test_their_own_package_reads_it(sequences, tmp_path):
    datasets = pytest.importorskip("datasets")
    out = export(HuggingFace(), sequences, tmp_path / "out")
    found = datasets.load_dataset(str(out), cache_dir=str(tmp_path / "cache"))
    assert {name: len(split) for name, split in found.items()} == {"train": 10, "test": 5}
    row = found["train"][3]
    np.testing.assert_array_equal(np.asarray(row["rgb"]), sequences[0].image("rgb", 3))
    np.testing.assert_array_equal(row["T_world_camera"], sequences[0].Ts_world_camera[3])
    assert found["train"][7]["depth"] is None
    assert found["train"][7]["sequence"] == "real"


def test_a_data_set_without_splits_is_their_train(sequences, tmp_path):
    out = export(HuggingFace(), [replace(sequences[1], split=None)], tmp_path / "out")
    assert [path.name for path in out.glob("data/*")] == ["train-00000-of-00001.parquet"]


def test_bad_folders_are_one_clear_line(tmp_path):
    with pytest.raises(InputError, match=r"contains no data/\*\.parquet"):
        HuggingFace().read(tmp_path)
    path = tmp_path / "data/train-00000-of-00001.parquet"
    path.parent.mkdir()
    path.write_bytes(b"PAR1 no more")
    with pytest.raises(InputError, match=r"Cannot read .*train-00000-of-00001\.parquet"):
        HuggingFace().read(tmp_path)
    import pyarrow as pa

    pq.write_table(pa.table({"image": [b""]}), path)
    with pytest.raises(InputError, match=r"A sample in .* lacks 'sequence'"):
        HuggingFace().read(tmp_path)
    with pytest.raises(InputError, match="shard_mb is -1"):
        HuggingFace(shard_mb=-1.0)
