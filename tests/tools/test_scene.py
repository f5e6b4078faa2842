"""Scenes as MJCF and USD: MuJoCo and usd-core agree with the episode on poses and masses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import vrcaps
from tests.support.small_envs import GUT
from vrcaps.actuation.arm.arm import frames
from vrcaps.actuation.arm.arm_with_payload import (
    ArmWithPayload,
    magnet_pose_at,
    transverse_mount,
)
from vrcaps.actuation.coil_program import CoilSteering
from vrcaps.actuation.steering_program import MagnetSteering
from vrcaps.capsule.device import homogeneous_body
from vrcaps.cli import episodes as commands
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import matrix_from_quaternion
from vrcaps.motion.dynamics import Dynamics
from vrcaps.recording.episode import Episode, read_episode
from vrcaps.recording.recorder import record
from vrcaps.scenario.scenario import Scenario
from vrcaps.tools.scene import PosedArm, Scene, scene_of, write_scene

pytestmark = pytest.mark.slow  # of the recording with an arm


def recorded(folder: Path, **motion: Any) -> Episode:
    """Episode of two frames whose capsule is moved by a magnet or by coils."""
    device = vrcaps.read_device("magnetic")
    lens = vrcaps.LensEquidistant(focal=6.0, cx=7.5, cy=7.5)
    small = vrcaps.Camera("front", lens, 16, 16, position=(0.0, 0.0, 9e-3))
    scenario = Scenario(
        GUT,
        replace(device, cameras=(small,)),
        motion=Dynamics(start=0.5, dynamics="quasi-static", settle=0.0, substep=1e-3, **motion),
        frames=2,
        channels=("depth",),
        effects=vrcaps.Effects.none(),
    )
    return read_episode(record(scenario, folder))


@pytest.fixture(scope="module")
def episode(tmp_path_factory) -> Episode:
    magnet = MagnetSteering(arm="panda", standoff=0.1)
    return recorded(tmp_path_factory.mktemp("scene") / "episode", magnet=magnet)


@pytest.fixture(scope="module")
def scene(episode) -> Scene:
    return scene_of(episode, 1)


def test_the_scene_is_that_of_the_frame(episode, scene):
    np.testing.assert_allclose(scene.T_world_capsule, episode.Ts_world_capsule[1])
    assert scene.capsule.mass == homogeneous_body(vrcaps.read_device("magnetic")).mass
    mount = transverse_mount(scene.magnet)
    robot = ArmWithPayload(scene.arm.arm, scene.magnet, scene.arm.T_world_base, mount)
    ours = magnet_pose_at(robot, scene.arm.angles)
    np.testing.assert_allclose(ours, scene.magnet.T_world_magnet, atol=1e-9)


def test_mujoco_has_the_same_poses_and_masses(scene, tmp_path):
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(write_scene(scene, tmp_path / "scene.xml")))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("recorded").id)
    mujoco.mj_forward(model, data)
    for name, pose in (
        ("capsule", scene.T_world_capsule),
        ("magnet", scene.magnet.T_world_magnet),
        ("base", scene.arm.T_world_base),
    ):
        np.testing.assert_allclose(data.body(name).xpos, pose[:3, 3], atol=1e-9)
        turn = data.body(name).xmat.reshape(3, 3)
        np.testing.assert_allclose(turn, pose[:3, :3], atol=1e-9)
    assert model.body("capsule").mass[0] == pytest.approx(scene.capsule.mass, rel=1e-12)
    assert model.body("magnet").mass[0] == pytest.approx(scene.magnet.mass, rel=1e-12)
    inertia = np.sort(np.diag(scene.capsule.inertia))[::-1]
    np.testing.assert_allclose(model.body("capsule").inertia, inertia, rtol=1e-12)
    assert model.njnt == 8
    masses = scene.arm.masses()
    stated = sum(each.mass for each in scene.arm.arm.masses)
    assert stated == pytest.approx(
        0.629769 + 4.970684 + 0.646926 + 3.228604 + 3.587895 + 1.225946 + 1.666555 + 0.735522
    )
    total = scene.capsule.mass + scene.magnet.mass + stated
    assert mujoco.mj_getTotalmass(model) == pytest.approx(total, rel=1e-12)
    for k in range(1, 8):
        body = model.body(f"link_{k}")
        np.testing.assert_allclose(body.ipos, masses[k].center, atol=1e-12)
        moments = np.linalg.eigvalsh(masses[k].tensor)[::-1]
        np.testing.assert_allclose(body.inertia, moments, rtol=1e-8)
    geom = model.geom("wall")
    vertices = (
        model.mesh_vert[: len(scene.wall.vertices)]
        @ matrix_from_quaternion(model.geom_quat[geom.id]).T
    )
    found = vertices + model.geom_pos[geom.id]
    for extreme in ("min", "max"):
        ours, theirs = (getattr(v, extreme)(axis=0) for v in (scene.wall.vertices, found))
        np.testing.assert_allclose(theirs, ours, atol=1e-5)


def test_the_capsule_falls_freely_in_mujoco(scene, tmp_path):
    """z = −g t²/2; the wall is visual, so that nothing holds the capsule."""
    mujoco = pytest.importorskip("mujoco")
    alone = replace(scene, arm=None, magnet=None)
    model = mujoco.MjModel.from_xml_path(str(write_scene(alone, tmp_path / "scene.xml")))
    data = mujoco.MjData(model)
    model.opt.timestep = 1e-4
    for _ in range(1000):
        mujoco.mj_step(model, data)
    fallen = scene.T_world_capsule[2, 3] - data.body("capsule").xpos[2]
    assert fallen == pytest.approx(0.5 * 9.80665 * 0.1**2, rel=2e-3)


def test_a_magnet_without_an_arm_is_a_mocap_body(scene, tmp_path):
    mujoco = pytest.importorskip("mujoco")
    free = replace(scene, arm=None)
    model = mujoco.MjModel.from_xml_path(str(write_scene(free, tmp_path / "scene.xml")))
    assert model.nmocap == 1
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.body("magnet").xpos, scene.magnet.T_world_magnet[:3, 3])


@pytest.mark.parametrize("suffix", [".usda", ".usdc"])
def test_usd_has_the_same_poses_and_masses(scene, tmp_path, suffix):
    usd = pytest.importorskip("pxr.Usd")
    from pxr import UsdGeom, UsdPhysics

    stage = usd.Stage.Open(str(write_scene(scene, tmp_path / f"scene{suffix}")))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    cache = UsdGeom.XformCache()
    placed = frames(scene.arm.arm, scene.arm.angles)
    for name, pose, mass in (
        ("capsule", scene.T_world_capsule, scene.capsule.mass),
        ("magnet", scene.magnet.T_world_magnet, scene.magnet.mass),
        ("base", scene.arm.T_world_base, 0.629769),
        ("link_4", scene.arm.T_world_base @ placed[3], 3.587895),
        ("flange", scene.arm.T_world_base @ placed[-1], None),
    ):
        prim = stage.GetPrimAtPath(f"/scene/{name}")
        theirs = np.array(cache.GetLocalToWorldTransform(prim)).T
        np.testing.assert_allclose(theirs, pose, atol=1e-12)
        if mass is not None:
            stated = UsdPhysics.MassAPI(prim).GetMassAttr().Get()
            assert stated == pytest.approx(mass, rel=1e-6)
    link = UsdPhysics.MassAPI(stage.GetPrimAtPath("/scene/link_4"))
    np.testing.assert_allclose(link.GetCenterOfMassAttr().Get(), (-0.05317, 0.104419, 0.027454))
    turn = link.GetPrincipalAxesAttr().Get()
    R = matrix_from_quaternion(np.array([turn.GetReal(), *turn.GetImaginary()], float))
    tensor = R @ np.diag(link.GetDiagonalInertiaAttr().Get()) @ R.T
    np.testing.assert_allclose(tensor, scene.arm.masses()[4].tensor, atol=1e-7)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/scene/wall"))
    points = np.array(mesh.GetPointsAttr().Get())
    np.testing.assert_allclose(points, scene.wall.vertices, atol=1e-6)
    shell = UsdGeom.Capsule(stage.GetPrimAtPath("/scene/capsule/shell"))
    assert shell.GetHeightAttr().Get() == pytest.approx(2 * scene.capsule.half_axis)


@pytest.mark.parametrize("name", ["ur5", "xarm7"])
def test_the_mass_matrix_of_an_arm_from_a_urdf_is_pinocchios(scene, tmp_path, name):
    """Masses, centers and inertias from the URDF, through the MJCF, at an angle of every joint."""
    mujoco, pinocchio = pytest.importorskip("mujoco"), pytest.importorskip("pinocchio")
    from tests.actuation.arm.test_urdf import FILES, read

    arm, count = read(name), FILES[name][2]
    angles = np.linspace(-0.4, 0.9, count).clip(arm.lower, arm.upper)
    posed = replace(scene, magnet=None, arm=PosedArm(arm, np.eye(4), angles))
    model = mujoco.MjModel.from_xml_path(str(write_scene(posed, tmp_path / "arm.xml")))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    matrix = np.zeros((model.nv, model.nv))
    for column, unit in zip(matrix, np.eye(model.nv), strict=True):
        mujoco.mj_mulM(model, data, column, unit)
    theirs = pinocchio.buildModelFromUrdf(str(FILES[name][0]))
    locked = [theirs.getJointId(joint) for joint in list(theirs.names)[count + 1 :]]
    theirs = pinocchio.buildReducedModel(theirs, locked, pinocchio.neutral(theirs))
    expected = pinocchio.crba(theirs, theirs.createData(), angles)
    expected = np.triu(expected) + np.triu(expected, 1).T
    np.testing.assert_allclose(matrix[6:, 6:], expected, atol=1e-9)


def test_links_without_a_stated_mass_have_that_of_their_capsules(scene):
    bare = replace(scene.arm, arm=replace(scene.arm.arm, masses=scene.arm.arm.masses[1:3]))
    masses = bare.masses()
    assert masses[1].mass == 4.970684
    assert 0 not in masses
    r, h = 0.06, 0.15
    one = 1000.0 * np.pi * r**2 * (h + 4.0 / 3.0 * r)
    assert masses[3].mass == pytest.approx(one)
    np.testing.assert_allclose(masses[3].tensor, 0.01 * one * np.eye(3))


def test_what_cannot_be_written_is_one_line(episode, scene, tmp_path):
    with pytest.raises(InputError, match=r"a\.txt: unknown kind of scene\. Allowed: \.xml, \.usda"):
        write_scene(scene, tmp_path / "a.txt")
    with pytest.raises(InputError, match=r"frame is 2\. Allowed: 0 to 1"):
        scene_of(episode, 2)
    pytest.importorskip("pxr")
    (tmp_path / "folder.usda").mkdir()
    with pytest.raises(InputError, match=r"Cannot write .*folder\.usda: Is a directory"):
        write_scene(scene, tmp_path / "folder.usda")
    (tmp_path / "file").touch()
    for suffix in (".xml", ".usda"):
        with pytest.raises(InputError, match=rf"Cannot write .*scene\{suffix}: File exists"):
            write_scene(scene, tmp_path / "file" / f"scene{suffix}")


def test_a_missing_folder_is_created(scene, tmp_path):
    path = write_scene(scene, tmp_path / "new" / "deep" / "scene.xml")
    assert ElementTree.parse(path).getroot().tag == "mujoco"
    assert path.with_name("scene-wall.obj").is_file()


def test_the_verb_says_what_it_wrote(episode, tmp_path, capsys):
    commands.Scene(episode.path, tmp_path / "a.xml", frame=1).run()
    assert capsys.readouterr().out == f"Wrote wall, capsule, magnet, arm to {tmp_path / 'a.xml'}.\n"
    assert (tmp_path / "a-wall.obj").is_file()


def test_the_verb_says_that_coils_are_omitted(tmp_path, capsys):
    episode = recorded(tmp_path / "episode", coils=CoilSteering())
    commands.Scene(episode.path, tmp_path / "a.xml").run()
    expected = f"Wrote wall, capsule to {tmp_path / 'a.xml'}, without the coils.\n"
    assert capsys.readouterr().out == expected
