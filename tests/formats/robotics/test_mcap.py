"""MCAP: round trip, and what the mcap package and OpenCV make of it."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader

from vrcaps.camera.lens import LensEquidistant, LensScaramuzza
from vrcaps.core.errors import InputError, MissingExtraError
from vrcaps.core.geometry import matrix_from_quaternion
from vrcaps.formats.io import export
from vrcaps.formats.robotics.foxglove_schemas import time_ns
from vrcaps.formats.robotics.mcap import Mcap

STORED = ("rgb", "depth", "label", "instance", "occlusion")


def messages(path) -> dict[str, list[tuple[int, dict]]]:
    """Time and content of all messages by topic, read by the mcap package."""
    found = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            content = json.loads(message.data)
            assert channel.message_encoding == "json"
            assert set(content) <= set(json.loads(schema.data)["properties"])
            found.setdefault(channel.topic, []).append((message.log_time, content))
    return found


def test_what_was_written_is_read(fisheye_episode, tmp_path):
    sequence = replace(fisheye_episode.sequence(), split="train", patient="7")
    (found,) = Mcap().read(export(Mcap(), [sequence], tmp_path / "out"))
    assert (found.name, found.split, found.patient) == (sequence.name, "train", "7")
    assert found.camera == sequence.camera
    assert found.label_names == sequence.label_names
    assert found.channels == STORED
    np.testing.assert_allclose(found.times, sequence.times, atol=0.5e-9)
    for name in ("T_world_camera", "T_world_capsule"):
        np.testing.assert_allclose(found.values[name], sequence.values[name], atol=1e-9)
    for k in range(len(sequence)):
        for channel in STORED:
            values = found.image(channel, k)
            assert values.dtype == sequence.image(channel, k).dtype
            np.testing.assert_array_equal(values, sequence.image(channel, k))


def test_messages_are_in_the_order_of_time_with_frames_and_states(pinhole_episode, tmp_path):
    out = export(Mcap(), [pinhole_episode.sequence()], tmp_path / "out")
    (path,) = out.rglob("*.mcap")
    found = messages(path)
    with path.open("rb") as file:
        times = [m.log_time for _, _, m in make_reader(file).iter_messages(log_time_order=False)]
    assert times == sorted(times)
    expected = [round(time * 1e9) for time in pinhole_episode.times]
    assert [ns for ns, _ in found["/front/rgb"]] == expected
    columns = pinhole_episode.table.columns
    for k, (_, row) in enumerate(found["/capsule"]):
        assert row["capsule_vx_m_per_s"] == columns["capsule_vx_m_per_s"][k]
        assert row["segment"] == columns["segment"][k]
        assert "front_x_m" not in row
    children = {t["child_frame_id"] for _, m in found["/tf"] for t in m["transforms"]}
    assert children == {"camera_front", "capsule", "patient"}
    (_, scene) = found["/scene"][0]
    capsule, organ = scene["entities"]
    (triangles,) = organ["triangles"]
    assert len(triangles["indices"]) == pinhole_episode.organ.faces.size
    points = np.array([[p[axis] for axis in "xyz"] for p in triangles["points"]])
    np.testing.assert_allclose(points, pinhole_episode.organ.vertices, atol=0.6e-6)
    assert capsule["frame_id"] == "capsule"
    assert capsule["cylinders"][0]["size"]["z"] == pytest.approx(24e-3 - 11e-3)


@pytest.mark.parametrize("lens", ["pinhole", "kannala-brandt", "equidistant"])
def test_opencv_projects_by_the_calibration_as_the_lens_does(
    pinhole_episode, fisheye_episode, tmp_path, lens
):
    """OpenCV has pixel centers at whole numbers, as ROS and Foxglove do."""
    episode = pinhole_episode if lens == "pinhole" else fisheye_episode
    sequence = episode.sequence()
    if lens == "equidistant":
        camera = replace(sequence.camera, lens=LensEquidistant(14.0, cx=19.75, cy=17.5))
        sequence = replace(sequence, camera=camera)
    (path,) = export(Mcap(organ=False), [sequence], tmp_path / "out").rglob("*.mcap")
    found = messages(path)
    _, calibration = found["/front/calibration"][0]
    K, D = np.array(calibration["K"]).reshape(3, 3), np.array(calibration["D"])
    T = sequence.Ts_world_camera[2]
    (transform,) = [
        t
        for ns, m in found["/tf"]
        for t in m["transforms"]
        if t["child_frame_id"] == "camera_front" and ns == time_ns(sequence.times[2])
    ]
    R = matrix_from_quaternion(np.array([transform["rotation"][k] for k in "wxyz"]))
    place = np.array([transform["translation"][k] for k in "xyz"])
    points_camera = np.array([[0.003, -0.002, 0.01], [-0.004, 0.001, 0.02], [0.0, 0.005, 0.009]])
    points_world = points_camera @ T[:3, :3].T + T[:3, 3]
    # World to camera by what the file says, then OpenCV's own projection.
    turn, shift = cv2.Rodrigues(R.T)[0], -R.T @ place
    kinds = {"plumb_bob": cv2.projectPoints, "kannala_brandt": cv2.fisheye.projectPoints}
    project = kinds[calibration["distortion_model"]]
    pixels, _ = project(points_world.reshape(-1, 1, 3), turn, shift, K, D)
    np.testing.assert_allclose(
        pixels[:, 0], sequence.camera.lens.project(points_camera), rtol=0, atol=1e-6
    )


def test_color_may_be_jpeg(pinhole_episode, tmp_path):
    sequence = pinhole_episode.sequence(channels=("rgb",))
    form = Mcap(jpeg_quality=95, organ=False)
    (found,) = form.read(export(form, [sequence], tmp_path / "out"))
    difference = found.image("rgb", 0).astype(float) - sequence.image("rgb", 0)
    assert 0.0 < np.abs(difference).mean() < 4.0


def test_the_same_frames_give_the_same_bytes(pinhole_episode, tmp_path):
    files = [
        next(export(Mcap(), [pinhole_episode.sequence()], tmp_path / name).rglob("*.mcap"))
        for name in ("a", "b")
    ]
    assert files[0].read_bytes() == files[1].read_bytes()


def test_bad_input_is_one_clear_line(pinhole_episode, tmp_path, monkeypatch):
    sequence = pinhole_episode.sequence()
    lens = LensScaramuzza(a0=14.0, a2=-0.01, a3=0.0, a4=0.0, cx=19.5, cy=17.5)
    other = replace(sequence, camera=replace(sequence.camera, lens=lens))
    with pytest.raises(InputError, match=r"mcap supports lenses of kind .*scaramuzza.*--rectify"):
        export(Mcap(), [other], tmp_path / "out")
    skewed = replace(sequence.camera, lens=replace(sequence.camera.lens, skew=0.1))
    with pytest.raises(InputError, match=r"skew of 0\.1 px.*--rectify"):
        export(Mcap(), [replace(sequence, camera=skewed)], tmp_path / "out")
    with pytest.raises(InputError, match=r"contains no \*\.mcap"):
        Mcap().read(tmp_path)
    path = tmp_path / "a.mcap"
    path.write_bytes(b"nothing")
    with pytest.raises(InputError, match="Cannot read"):
        Mcap().read(tmp_path)
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.finish()
    with pytest.raises(InputError, match="no metadata of vrcaps"):
        Mcap().read(tmp_path)
    monkeypatch.setitem(__import__("sys").modules, "mcap.writer", None)
    with pytest.raises(MissingExtraError, match="mcap"):
        export(Mcap(), [sequence], tmp_path / "out")
    assert not (tmp_path / "out").exists()
