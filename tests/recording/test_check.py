import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from vrcaps.capsule.device_file import read_device
from vrcaps.lumen.contents import Contents, Liquid
from vrcaps.magnet.sources import InternalMagnet
from vrcaps.mesh.mesh import Mesh
from vrcaps.mesh.read_mesh import read_mesh
from vrcaps.recording.check import check_episode
from vrcaps.recording.frame_files import read_image, write_images
from vrcaps.recording.recorder import record
from vrcaps.recording.table import FrameTable, read_table, write_table
from vrcaps.sensors.sensors import HallPad, Sensors


@pytest.fixture
def episode(recorded, tmp_path):
    out = tmp_path / "episode"
    shutil.copytree(recorded, out)
    return out


def _found(episode, where, what):
    problems = check_episode(episode)
    texts = [str(problem) for problem in problems]
    assert any(p.where.startswith(where) and what in p.what for p in problems), texts


def _edit_head(episode, change):
    head = json.loads((episode / "episode.json").read_text())
    change(head)
    (episode / "episode.json").write_text(json.dumps(head))


def _edit_image(episode, name, change):
    stored = read_image(episode / name)
    write_images([(episode / name, np.ascontiguousarray(change(stored)))])


def _edit_column(episode, name, change):
    table = read_table(episode / "frames.parquet")
    columns = {n: v.copy() for n, v in table.columns.items()}
    columns[name] = change(columns[name])
    write_table(episode / "frames.parquet", FrameTable(columns))


@pytest.mark.slow
def test_a_whole_episode_has_no_problems(recorded):
    calls = []
    assert check_episode(recorded, progress=lambda *call: calls.append(call)) == []
    assert calls == [(i, 5) for i in range(1, 6)]


@pytest.mark.slow
@pytest.mark.parametrize("says_where", [True, False])
def test_liquid_bends_rays_and_is_no_problem(scenario, tmp_path, says_where):
    channels = ("depth", "ray_distance", "normal", *(("refraction_label",) if says_where else ()))
    wet = replace(scenario, frames=2, contents=Contents(liquid=Liquid(0.3)), channels=channels)
    out = record(wet, tmp_path / "wet")
    assert check_episode(out) == []
    if not says_where:
        return
    labels = np.stack([read_image(p) for p in sorted(out.glob("front/refraction_label/*.png"))])
    assert (labels > 0).mean() > 0.05
    _edit_image(
        out,
        "front/ray_distance/000000.png",
        lambda stored: stored + np.where(labels[0] == 0, 40, 0).astype(stored.dtype),
    )
    _found(out, "front/ray_distance/000000.png", "agrees with")


@pytest.mark.slow
@pytest.mark.parametrize("most_tesla", [1e-7, 2e-6])
def test_hall_sensors_beyond_their_range_are_no_problem(
    scenario, device_file, tmp_path, most_tesla
):
    """Some readings are NaN, and without enough of them the place too, as the format says."""
    magnet = InternalMagnet((0.0, 0.0, 0.0), (0.0, 0.0, 0.1))
    sensors = Sensors(hall=HallPad(count=4, range=most_tesla), earth_field=(0.0, 0.0, 0.0))
    given = replace(
        scenario,
        frames=2,
        channels=("depth",),
        sensors=sensors,
        capsule=replace(read_device(device_file), magnets=(magnet,)),
    )
    out = record(given, tmp_path / "sensed")
    columns = read_table(out / "frames.parquet").columns
    assert any(np.isnan(v).any() for name, v in columns.items() if name.startswith("hall_"))
    assert np.isnan(columns["localized_x_m"]).any() == (most_tesla < 1e-6)
    assert check_episode(out) == []
    _edit_column(out, "hall_0_x_t", lambda v: np.full(len(v), np.inf))
    _found(out, "frames.parquet hall_0_x_t", "not finite")
    kept = {k: v for k, v in columns.items() if k != "hall_0_x_t"}
    write_table(out / "frames.parquet", FrameTable(kept))
    _found(out, "frames.parquet", "lacks the columns hall_0_x_t")


def test_no_episode(tmp_path):
    _found(tmp_path, "episode.json", "is not an episode")


@pytest.mark.slow
@pytest.mark.parametrize("key", ["status", "organ", "cameras"])
def test_an_interrupted_recording_is_the_only_fault(episode, key):
    """Also where the head lacks what is written later."""
    _edit_head(episode, lambda h: (h.update(status="recording"), key != "status" and h.pop(key)))
    (fault,) = check_episode(episode)
    assert str(fault) == (
        "episode.json: the recording was interrupted. To resume it: "
        f"vrcaps record {episode / 'episode.json'} --out {episode}"
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "what"),
    [
        (
            lambda h: h.update(status="recording"),
            "the recording was interrupted. To resume it: vrcaps record",
        ),
        (lambda h: h.update(format="other/1"), "has the format 'other/1'"),
        (lambda h: h["channels"]["depth"].update(scale=1.0), "channels.depth is not the encoding"),
        (lambda h: h["cameras"].clear(), "number of cameras is 0"),
        (lambda h: h["cameras"][0].pop("exposure"), "is not a camera"),
        (lambda h: h["cameras"][0]["lens"].update(kind="eye"), "cameras[0].lens.kind is 'eye'"),
        (lambda h: h["cameras"][0]["T_capsule_camera"][0].__setitem__(0, 2.0), "is not rigid"),
        (lambda h: h["T_world_patient"][0].__setitem__(3, float("nan")), "is not rigid"),
        (lambda h: h.pop("T_world_patient"), "the pose of the patient is not rigid"),
        (lambda h: h["scenario"].update(frames=6), "scenario has other frames or channels"),
        (lambda h: h["scenario"].update(speed=1), "Unknown key speed"),
        (lambda h: h.update(seed=h["seed"] + 1), "in the scenario"),
        (lambda h: h.update(seed=None), "seed is None"),
        (lambda h: h.update(vrcaps_version=1), "vrcaps_version is 1, not a text"),
        (lambda h: h.update(made_with=["numpy"]), "made_with does not state"),
        (lambda h: h["made_with"].update(numpy=2), "made_with does not state"),
        (lambda h: h.pop("organ"), "organ is None, not dict"),
        (lambda h: h.update(capsule=None), "capsule is None, not dict"),
        *(
            (lambda h, fps=fps: h.update(fps=fps), "fps is")
            for fps in (None, 0, -1.0, "x", True, 1e5, float("nan"))
        ),
        (lambda h: h["T_world_patient"][0].__setitem__(3, 10**400), "is not rigid"),
    ],
)
def test_broken_head(episode, change, what):
    _edit_head(episode, change)
    _found(episode, "episode.json", what)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("frames.parquet", "cannot be read (No such file or directory)"),
        ("organ.glb", "cannot be read"),
        ("sheet.png", "is missing or empty"),
        ("preview.mp4", "is missing or empty"),
        ("front/rgb/000001.png", "is missing"),
        ("rear/position/000004.npy", "is missing"),
    ],
)
def test_missing_files(episode, name, what):
    (episode / name).unlink()
    _found(episode, name, what)


@pytest.mark.parametrize(
    "name",
    ["frames.parquet", "organ.glb", "front/depth/000000.png", "front/position/000000.npy"],
)
@pytest.mark.parametrize("how", ["cut", "other"])
def test_corrupted_files(episode, name, how):
    data = (episode / name).read_bytes()
    (episode / name).write_bytes(data[: len(data) // 2] if how == "cut" else b"something else")
    _found(episode, name, "cannot be read")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "change", "what"),
    [
        (
            "front/rgb/000000.png",
            lambda a: a[:-1],
            "contains uint8 (35, 40, 3), not uint8 (36, 40, 3)",
        ),
        ("front/rgb/000000.png", lambda a: a[..., 0], "contains uint8 (36, 40), not"),
        (
            "front/label/000002.png",
            lambda a: a.astype(np.uint16),
            "contains uint16 (36, 40), not uint8",
        ),
        ("rear/position/000001.npy", lambda a: a.astype(float), "contains float64"),
        ("front/depth/000000.png", lambda a: a + np.uint16(300), "where the lens is blind"),
        (
            "front/depth/000000.png",
            lambda a: np.where(a > 0, a + 50, 0).astype(np.uint16),
            "differs from ray_distance along the lens's rays",
        ),
        (
            "rear/depth/000003.png",
            lambda a: a[:, ::-1],
            "differs from ray_distance",
        ),
        (
            "rear/normal/000003.png",
            lambda a: np.where(a > 0, 65535 - a + 1, 0).astype(np.uint16),
            "faces away from the camera",
        ),
        (
            "rear/normal/000003.png",
            lambda a: np.where(a > 0, (a // 2 + 16384), 0).astype(np.uint16),
            "is not of unit length",
        ),
        ("front/label/000001.png", lambda a: a + (a > 0) * np.uint8(7), "which has no label name"),
    ],
)
def test_wrong_images(episode, name, change, what):
    _edit_image(episode, name, change)
    _found(episode, name, what)


def test_images_of_another_frame(episode):
    """Consistent among themselves, but not what the pose sees in the organ."""
    for channel in ("depth", "ray_distance", "normal"):
        shutil.copy(
            episode / f"front/{channel}/000004.png", episode / f"front/{channel}/000000.png"
        )
    _found(episode, "front/ray_distance/000000.png", "agrees with organ.glb within 10 um at only")


@pytest.mark.parametrize(
    ("column", "change", "what"),
    [
        ("time_s", lambda v: v[::-1], "time does not increase"),
        ("time_s", lambda v: np.where(v > 0.5, np.nan, v), "not finite"),
        ("frame", lambda v: v + 1, "does not count"),
        ("capsule_qw", lambda v: v * 1.1 + 0.1, "capsule has no unit quaternion"),
        ("capsule_x_m", lambda v: v + 1e-3, "off that of the capsule and its mount"),
        ("rear_z_m", lambda v: v + 1e-3, "pose of rear is 0.001 off"),
        ("segment", lambda v: np.full(len(v), "elbow", object), "not a label name"),
    ],
)
def test_wrong_table(episode, column, change, what):
    _edit_column(episode, column, change)
    _found(episode, "frames.parquet", what)


def test_missing_column_and_rows(episode):
    table = read_table(episode / "frames.parquet")
    fewer = {n: v for n, v in table.columns.items() if n != "arc_length_m"}
    write_table(episode / "frames.parquet", FrameTable(fewer))
    _found(episode, "frames.parquet", "lacks the columns arc_length_m")
    write_table(
        episode / "frames.parquet", FrameTable({n: v[1:] for n, v in table.columns.items()})
    )
    _found(episode, "frames.parquet", "has 4 rows for 5 frames")


def test_another_organ(episode, tmp_path):
    import trimesh

    mesh: Mesh = read_mesh(episode / "organ.glb", unit="m")
    wrong = trimesh.Trimesh(mesh.vertices, mesh.faces[:-5], process=False)
    wrong.export(episode / "organ.glb")
    _found(episode, "organ.glb", "triangles, not")
    moved = trimesh.Trimesh(mesh.vertices * 1.001, mesh.faces, process=False)
    moved.export(episode / "organ.glb")
    _found(episode, "front/ray_distance/000000.png", "agrees with organ.glb")
