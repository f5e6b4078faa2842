import json
import shutil

import numpy as np
import pytest

from vrcaps.camera.camera import camera_rays
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.geometry import transform_points
from vrcaps.recording.episode import read_episode
from vrcaps.render.channels import CHANNELS
from vrcaps.render.renderer import Renderer
from vrcaps.scenario.build import build, resolve


def test_arrays_are_what_was_rendered(recorded, scenario):
    """Every channel comes back from the files within half a step of the renderer's own."""
    episode = read_episode(recorded)
    model, trajectory = build(scenario)
    renderer = Renderer(model, scenario.render)
    rendered = renderer.render(
        trajectory.state(2),
        model.device.cameras[1],
        channels=tuple(CHANNELS),
        state_next=trajectory.state(3),
        state_previous=trajectory.state(1),
    )
    read = episode.frame(2, "rear")
    for channel in CHANNELS:
        given, back = getattr(rendered, channel), getattr(read, channel)
        step = CHANNELS[channel].encoding.scale
        if step is None:
            np.testing.assert_array_equal(back, given)
            continue
        valid = np.isfinite(back)
        np.testing.assert_allclose(back[valid], given[valid], rtol=1e-6, atol=0.51 * step)
        if not channel.startswith("flow"):
            np.testing.assert_array_equal(valid, np.isfinite(given))


def test_positions_project_to_their_pixels(recorded):
    """Pose, lens and position of one pixel agree: project(T_camera_world · position) = pixel."""
    episode = read_episode(recorded)
    for camera in episode.cameras:
        for frame in range(len(episode)):
            position = episode.image(camera.name, "position", frame).astype(float)
            seen = np.isfinite(position).all(axis=-1)
            T_world_camera = episode.Ts_world_camera(camera.name)[frame]
            points = transform_points(np.linalg.inv(T_world_camera), position[seen])
            pixels = camera.lens.project(points)
            rows, columns = np.nonzero(seen)
            error = np.abs(pixels - np.stack([columns, rows], axis=-1))
            assert error.max() < 1e-2
            depth = episode.image(camera.name, "depth", frame)[seen]
            np.testing.assert_allclose(points[:, 2], depth, atol=1.1e-5)


def test_depth_is_ray_distance_times_the_ray(recorded):
    episode = read_episode(recorded)
    camera = episode.camera("front")
    frame = episode.frame(0)
    expected = frame.ray_distance * camera_rays(camera)[..., 2]
    np.testing.assert_allclose(frame.depth, expected, atol=1.1e-5)


def test_metadata(recorded, scenario):
    episode = read_episode(recorded)
    assert len(episode) == 5
    about = f"Episode({recorded.name!r}, frames=5, cameras=('front', 'rear'), channels=('rgb', "
    assert repr(episode).startswith(about) and "\n" not in repr(episode)
    assert episode.channels == tuple(CHANNELS)
    assert [camera.name for camera in episode.cameras] == ["front", "rear"]
    assert episode.label_names == ("background", "upper", "lower")
    assert episode.scenario == resolve(scenario).scenario
    np.testing.assert_allclose(episode.times, np.arange(5) / 4.0)
    mount = episode.camera("rear").T_capsule_camera
    np.testing.assert_allclose(
        episode.Ts_world_camera("rear"), episode.Ts_world_capsule @ mount, atol=1e-12
    )
    assert len(list(episode.frames("rear"))) == 5


def test_organ_is_the_wall_in_the_world(recorded, scenario):
    """The GLB's triangles are the organ's, in single precision."""
    model, _ = build(scenario)
    mesh = read_episode(recorded).organ
    assert len(mesh.faces) == len(model.organ.faces)
    expected = model.vertices_world[model.organ.faces]
    np.testing.assert_allclose(mesh.vertices[mesh.faces], expected, atol=1e-7)


def test_unknown_names_and_frames(recorded):
    episode = read_episode(recorded)
    with pytest.raises(UnknownNameError, match=r"No camera named 'side'\. Known: front, rear"):
        episode.image("side", "rgb", 0)
    with pytest.raises(UnknownNameError, match="No channel named 'heat'"):
        episode.image("front", "heat", 0)
    with pytest.raises(InputError, match=r"No frame 5 in .*Allowed: 0 to 4"):
        episode.image("front", "rgb", 5)


def test_no_episode(tmp_path):
    with pytest.raises(InputError, match=r"is not an episode: it contains no episode\.json"):
        read_episode(tmp_path)


def test_unreadable_image(recorded, tmp_path):
    out = tmp_path / "episode"
    shutil.copytree(recorded, out)
    (out / "front/depth/000001.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match=r"Cannot read .*000001\.png .* `vrcaps check"):
        read_episode(out).image("front", "depth", 1)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"frames": "5"}, "frames is '5', not int"),
        ({"channels": {"heat": {}}}, "No channel named 'heat'"),
        ({"frames": -1}, "frames is -1. Allowed: 1 to 1000000"),
        ({"frames": True}, "frames is True, not int"),
        ({"channels": {}}, "number of channels is 0"),
        ({"wall": {"num_vertices": -4}}, "wall.num_vertices is -4"),
        ({"wall": []}, "wall.num_vertices is None"),
        ({"organ": {}}, "organ.label_names is missing"),
        ({"organ": {"label_names": [1]}}, "organ.label_names is missing or not a list of strings"),
        ({"cameras": []}, "number of cameras is 0"),
        ({"cameras": [{}]}, r"cameras\[0\] is not a camera. Allowed: a table with exactly name"),
    ],
)
def test_broken_head(recorded, tmp_path, change, match):
    head = json.loads((recorded / "episode.json").read_text())
    (tmp_path / "episode.json").write_text(json.dumps({**head, **change}))
    with pytest.raises((InputError, UnknownNameError), match=match):
        read_episode(tmp_path)


@pytest.mark.parametrize(
    ("names", "match"),
    [
        (
            ("patient", "rear"),
            r"cameras\[0\]: Camera's name is 'patient'. Allowed: any but capsule",
        ),
        (("../front", "rear"), r"cameras\[0\]: Camera's name is '../front'. Allowed: letters"),
        (("Rear", "rear"), r"Two cameras share a name \(Rear, rear\)"),
    ],
)
def test_names_of_cameras_are_checked_as_on_writing(recorded, tmp_path, names, match):
    head = json.loads((recorded / "episode.json").read_text())
    for camera, name in zip(head["cameras"], names, strict=True):
        camera["name"] = name
    (tmp_path / "episode.json").write_text(json.dumps(head))
    with pytest.raises(InputError, match=match):
        read_episode(tmp_path)


def test_a_head_nested_too_deeply(tmp_path):
    (tmp_path / "episode.json").write_text("[" * 100_000)
    with pytest.raises(InputError, match="is not an episode: cannot read"):
        read_episode(tmp_path)
