"""All readers with small whole inputs, for `reader_fuzz`."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tests.support.ellipsoid_sequence import ellipsoid_sequence
from tests.support.reader_fuzz import InvalidError, Target
from vrcaps.camera.lens import LensPinhole
from vrcaps.capsule.device_file import read_device_file, write_device
from vrcaps.formats.format import FORMATS
from vrcaps.formats.io import export, read_format
from vrcaps.recording.episode import Episode, read_episode
from vrcaps.recording.frame_sequence import FrameSequence

OF_EPISODES = ("coco", "bop", "lerobot", "mcap")
"""Formats that are written from episodes."""
_LENS = LensPinhole(fx=25.0, fy=24.0, cx=20.25, cy=17.5)


def all_targets(folder: Path, episode: Episode) -> list[Target]:
    """A target for each reader.

    Args:
        folder: New; holds the inputs.
        episode: A short recording through a pinhole.
    """
    sequence = ellipsoid_sequence(_LENS, 40, 36, frames=3)
    (recorded,) = episode.sequences()
    targets = [
        _format(folder, kind, recorded if kind in OF_EPISODES else sequence)
        for kind in FORMATS
        if kind != "minari"  # Minari itself reads it
    ]
    more = (_episode, _ledger, _plan, _scenario, _device, _tum, _euroc, _unity, _pictures)
    more += (_wrenches, _field_map, _policy, _meshes)
    return [*targets, *(make(folder, episode) for make in more), *_weights(folder)]


def recorded_tube(folder: Path) -> Episode:
    """A short recording of a small tube, with what formats of lesions need."""
    import trimesh

    from tests.support.small_episode import CAMERA, DEVICE
    from tests.support.write_ply import write_ply
    from vrcaps.mesh.mesh import Mesh
    from vrcaps.motion.fly_through import FlyThrough
    from vrcaps.organ.read_organ import read_organ
    from vrcaps.recording.recorder import record
    from vrcaps.scenario.scenario import Scenario

    folder.mkdir(parents=True)
    tube = trimesh.creation.capsule(height=0.2, radius=0.02, count=[24, 32])
    write_ply(folder / "tube.ply", Mesh(np.asarray(tube.vertices), np.asarray(tube.faces)))
    organ = read_organ(folder / "tube.ply", unit="m")
    instance = (np.abs(organ.arc_length - 0.1) < 0.02).astype(np.uint16)
    lesion = {"instance": 1, "kind": "polyp", "visible_diameter_m": 0.01}
    organ = replace(organ, instance=instance, metadata={**organ.metadata, "lesions": [lesion]})
    front = CAMERA.format(name="front", z=11, rotation="[[1, 0, 0], [0, 1, 0], [0, 0, 1]]")
    (folder / "tiny.toml").write_text(DEVICE + front)
    device = read_device_file(folder / "tiny.toml")
    camera = replace(device.cameras[0], lens=_LENS)
    scenario = Scenario(
        organ=organ,
        capsule=replace(device, cameras=(camera,)),
        motion=FlyThrough(start=0.15, end=0.85),
        frames=3,
        channels=("rgb", "depth", "label", "instance"),
    )
    return read_episode(record(scenario, folder / "episode"))


def check_sequence(sequence: FrameSequence) -> None:
    """Check what a reader gives, the first and the last frame too.

    Raises:
        InvalidError: If a time, a pose or a distance is impossible.
    """
    if not np.isfinite(sequence.times).all() or (np.diff(sequence.times) <= 0).any():
        raise InvalidError(f"times {sequence.times}")
    for name, rows in sequence.values.items():
        if name.startswith("T_"):
            check_poses(rows)
    for index in {0, len(sequence) - 1} if len(sequence) else ():
        frame = sequence[index]
        depth = frame.get("depth", np.zeros(0))
        if np.isinf(depth).any() or (depth < 0.0).any():
            raise InvalidError("depth is negative or infinite")
        if frame["rgb"].dtype != np.uint8 or frame["rgb"].shape[2:] != (3,):
            raise InvalidError(f"color is {frame['rgb'].dtype} {frame['rgb'].shape}")


def check_poses(poses: np.ndarray) -> None:
    """Check that matrices are finite and rigid to 0.1 %.

    Raises:
        InvalidError: If they are not.
    """
    rotation = poses[:, :3, :3]
    off = np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3))
    if not (
        np.isfinite(poses).all() and (off < 2e-3).all() and (np.linalg.det(rotation) > 0).all()
    ):
        raise InvalidError("poses are not rigid")


def _format(folder: Path, kind: str, sequence: FrameSequence) -> Target:
    options: dict[str, Any] = {"lerobot": {"images": True}, "mcap": {"organ": False}}.get(kind, {})
    out = export(FORMATS[kind](**options), [sequence], folder / kind)
    return Target(kind, out, partial(_read_format, kind))


def _read_format(kind: str, folder: Path) -> None:
    for sequence in read_format(kind, folder):
        check_sequence(sequence)


def _copy(folder: Path, episode: Episode) -> Path:
    return Path(shutil.copytree(episode.path, folder))


def _episode(folder: Path, episode: Episode) -> Target:
    def read(place: Path) -> None:
        found = read_episode(place)
        for sequence in found.sequences():
            check_sequence(sequence)
        _ = found.scenario

    return Target("episode", _copy(folder / "episode", episode), read)


def _ledger(folder: Path, episode: Episode) -> Target:
    from vrcaps.data.ledger import EPISODES, FAILED, LEDGER, PLAN, entry_of
    from vrcaps.data.plan import plan_to_plain, read_plan
    from vrcaps.data.units import Unit

    place = folder / "dataset"
    recording = _copy(place / EPISODES / "tiny-0000", episode)
    unit = Unit(0, 0, "train", "tiny-0000", episode.scenario)
    failure = {"number": 1, "error": "none", "reproduce": "vrcaps"}
    for name, plain in (
        (f"{LEDGER}/tiny-0000.json", entry_of(unit, recording)),
        (f"{FAILED}/tiny-0001.json", failure),
        (PLAN, plan_to_plain(read_plan(_write_plan(folder / "plan-of-dataset")))),
    ):
        (place / name).parent.mkdir(exist_ok=True)
        (place / name).write_text(json.dumps(plain, default=str))
    return Target("ledger", place, _read_dataset, depth=2)


def _read_dataset(place: Path) -> None:
    from vrcaps.data import dataset
    from vrcaps.data.card import read_plan_of
    from vrcaps.data.dataset import rows_of
    from vrcaps.data.ledger import failures
    from vrcaps.data.store import open_store

    store, found = open_store(place), dataset.open(place)
    read_plan_of(store)
    failures(store)
    for member in found:
        if member.split not in ("train", "val", "test") or type(member.patient) is not int:
            raise InvalidError(f"a recording of {member.patient!r} in {member.split!r}")
    for row in rows_of(store):
        if not (row.frames > 0 and np.isfinite(row.about["seconds"])):
            raise InvalidError("a recording without frames")


def _write_plan(folder: Path) -> Path:
    folder.mkdir()
    path = folder / "plan.toml"
    path.write_text(
        'frames = 2\ncapsule = "mirocam"\nseed = { integer = [0, 9] }\n\n[organ]\n'
        'kind = "generated"\nname = "stomach"\n\n[motion]\nspeed = { each = [0.005, 0.01] }\n'
        'drift = { uniform = [0.0, 0.3] }\n\n[dataset]\nname = "tiny"\npatients = 4\n'
    )
    return path


def _plan(folder: Path, episode: Episode) -> Target:
    def read(place: Path) -> None:
        from vrcaps.data.plan import read_plan
        from vrcaps.data.units import Units

        _ = len(Units(read_plan(place / "plan.toml")))

    return Target("plan", _write_plan(folder / "plan").parent, read)


def _scenario(folder: Path, episode: Episode) -> Target:
    from vrcaps.scenario.scenario import read_scenario, scenario_to_plain

    place = folder / "scenario"
    place.mkdir()
    (place / "scenario.json").write_text(json.dumps(scenario_to_plain(episode.scenario)))
    (place / "scenario.toml").write_text(
        'frames = 9\nfps = 4.0\ncapsule = "mirocam"\nchannels = ["rgb", "depth"]\n[motion]\n'
        'kind = "fly-through"\nspeed = 0.02\n[effects]\nsensor_noise = 2\n[render]\n'
        'light = "direct"\n'
    )

    def read(where: Path) -> None:
        for path in sorted(where.iterdir()):
            found = read_scenario(path)
            if not (found.frames > 0 and 0.0 < found.fps < np.inf):
                raise InvalidError(f"{found.frames} frames at {found.fps} Hz")

    return Target("scenario", place, read)


def _device(folder: Path, episode: Episode) -> Target:
    place = folder / "device"
    place.mkdir()
    device = replace(episode.scenario.capsule, led_spectrum=None)
    write_device(place / "device.toml", device)

    def read(where: Path) -> None:
        device = read_device_file(where / "device.toml")
        check_poses(np.stack([camera.T_capsule_camera for camera in device.cameras]))
        if not (0.0 < device.length < np.inf and 0.0 < device.mass < np.inf):
            raise InvalidError(f"{device.length} m, {device.mass} kg")

    return Target("device", place, read)


def _path(folder: Path, name: str, text: str, read: Callable[[Path], Any]) -> Target:
    place = folder / name
    place.mkdir()
    suffix = ".txt" if name == "path-tum" else ".csv"
    (place / f"path{suffix}").write_text(text)

    def read_path(where: Path) -> None:
        found = read(where / f"path{suffix}")
        check_poses(found.Ts_world_capsule)
        if not (np.diff(found.times) > 0.0).all():
            raise InvalidError(f"times {found.times}")

    return Target(name, place, read_path)


def _tum(folder: Path, episode: Episode) -> Target:
    from vrcaps.motion.replay import read_tum

    rows = "".join(f"{1.3e9 + 0.1 * k:.6f} {0.01 * k} 0 0 0 0 0.6 0.8\n" for k in range(6))
    text = f"# timestamp tx ty tz qx qy qz qw\n{rows}"
    return _path(folder, "path-tum", text, partial(read_tum, unit="m"))


def _euroc(folder: Path, episode: Episode) -> Target:
    from vrcaps.motion.replay import read_euroc_csv

    start = 1_403_636_579_763_555_584
    rows = "".join(f"{start + k * 10**8},{0.01 * k},0,0,0.8,0,0,0.6,0,0\n" for k in range(6))
    text = f"#timestamp [ns],p_x,p_y,p_z,q_w,q_x,q_y,q_z,v_x,v_y\n{rows}"
    return _path(folder, "path-euroc", text, partial(read_euroc_csv, unit="m"))


def _unity(folder: Path, episode: Episode) -> Target:
    from vrcaps.motion.replay import read_unity_csv

    rows = "".join(f"{0.1 * k};0;0;0;0;0;1;{0.5 * k}\n" for k in range(6))
    text = f"tX;tY;tZ;rX;rY;rZ;rW;time(s)\n{rows}"
    read = partial(read_unity_csv, unit="m", handedness="left")
    return _path(folder, "path-unity", text, read)


def _pictures(folder: Path, episode: Episode) -> Target:
    from PIL import Image

    from vrcaps.tools.photos import read_photos

    place = folder / "pictures"
    place.mkdir()
    image = Image.fromarray(episode.frame(0, channels=("rgb",)).rgb)
    exif = Image.Exif()
    exif[274] = 6
    for name in ("a.png", "b.jpg", "c.tif", "d.bmp", "e.webp"):
        image.save(place / name, **({"exif": exif} if name == "b.jpg" else {}))
    image.convert("CMYK").save(place / "f.jpg")
    image.convert("P").save(place / "g.png")

    def read(where: Path) -> None:
        for photo in read_photos([where]):
            if photo.rgb.dtype != np.uint8 or photo.rgb.ndim != 3:
                raise InvalidError(f"{photo.name} is {photo.rgb.dtype} {photo.rgb.shape}")

    return Target("pictures", place, read)


def _wrenches(folder: Path, episode: Episode) -> Target:
    from vrcaps.world.schedule import read_wrenches

    place = folder / "wrenches"
    place.mkdir()
    rows = "".join(f"{0.1 * k},0,0,0.01,0,1e-5,0\n" for k in range(5))
    (place / "wrenches.csv").write_text(f"time_s,fx_n,fy_n,fz_n,tx_nm,ty_nm,tz_nm\n{rows}")

    def read(where: Path) -> None:
        rows = [(w.time, *w.force, *w.torque) for w in read_wrenches(where / "wrenches.csv")]
        if not np.isfinite(rows).all():
            raise InvalidError("a wrench is not finite")

    return Target("wrenches", place, read)


def _field_map(folder: Path, episode: Episode) -> Target:
    from vrcaps.magnet.field_map import read_field_map

    place = folder / "field-map"
    place.mkdir()
    axis = np.linspace(-0.1, 0.1, 4)
    flux = np.random.default_rng(0).normal(size=(4, 4, 4, 3))
    np.savez(place / "map.npz", x=axis, y=axis, z=axis, flux_density=flux)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    rows = np.column_stack([grid, flux.reshape(-1, 3)])
    np.savetxt(place / "map.csv", rows, delimiter=",", header="x,y,z,bx,by,bz", comments="")

    def read(where: Path) -> None:
        for path in sorted(where.iterdir()):
            found = read_field_map(path, length_unit="m", flux_unit="mT")
            if not np.isfinite(found.flux_density).all():
                raise InvalidError("a flux density is not finite")

    return Target("field-map", place, read)


def _policy(folder: Path, episode: Episode) -> Target:
    from vrcaps.env.settings import EnvSettings
    from vrcaps.policy.mlp_policy import (
        MlpPolicy,
        Normalizer,
        kept_settings,
        read_mlp_policy,
        write_mlp_policy,
    )

    place, rng = folder / "policy", np.random.default_rng(0)
    place.mkdir()
    layers = [(rng.normal(size=(8, 19)), np.zeros(8)), (rng.normal(size=(6, 8)), np.zeros(6))]
    normalizer = Normalizer(np.zeros(19), np.ones(19))
    policy = MlpPolicy(layers, normalizer, kept_settings(EnvSettings()))
    write_mlp_policy(place / "policy.npz", policy, {})

    def read(where: Path) -> None:
        found = read_mlp_policy(where / "policy.npz")
        output = found.output({"state": np.zeros((1, len(found.normalizer.mean)))})
        if not np.isfinite(output).all():
            raise InvalidError("an action is not finite")

    return Target("policy", place, read)


def _meshes(folder: Path, episode: Episode) -> Target:
    import trimesh

    from vrcaps.mesh.read_mesh import read_mesh

    place = folder / "meshes"
    place.mkdir()
    mesh = trimesh.creation.icosphere(subdivisions=1)
    for suffix in ("ply", "stl", "obj", "glb"):
        mesh.export(place / f"mesh.{suffix}")

    def read(where: Path) -> None:
        for path in sorted(where.iterdir()):
            found = read_mesh(path, unit="m")
            if not np.isfinite(found.vertices).all():
                raise InvalidError("a vertex is not finite")
            if found.faces.min(initial=0) < 0 or found.faces.max(initial=0) >= len(found.vertices):
                raise InvalidError("a face is out of range")

    return Target("meshes", place, read)


def _weights(folder: Path) -> Sequence[Target]:
    """Weights of small networks; none where PyTorch is not installed."""
    try:
        import torch
    except ImportError:
        return ()
    from vrcaps.learn.checkpoint import read_weights, write_weights
    from vrcaps.learn.tasks.super_resolution import SuperResolutionTask

    place = folder / "weights"
    place.mkdir()
    learner = SuperResolutionTask(blocks=1, features=8)
    write_weights(place / "w.safetensors", learner, learner.network(is_pretrained=False), {})

    def read(where: Path) -> None:
        trained = read_weights(where / "w.safetensors")
        for name, value in trained.network.state_dict().items():
            if not torch.isfinite(value).all():
                raise InvalidError(f"{name} is not finite")

    return (Target("weights", place, read),)
