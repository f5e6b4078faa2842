"""Scenes as MJCF and USD: MuJoCo and usd-core agree with the episode on poses and masses."""

from __future__ import annotations

from dataclasses import replace

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
from vrcaps.actuation.steering_program import MagnetSteering
from vrcaps.capsule.device import homogeneous_body
from vrcaps.cli import episodes as commands
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import matrix_from_quaternion
from vrcaps.motion.dynamics import Dynamics
from vrcaps.recording.episode import Episode, read_episode
from vrcaps.recording.recorder import record
from vrcaps.scenario.scenario import Scenario
from vrcaps.tools.scene import Scene, scene_of, write_scene

pytestmark = pytest.mark.slow  # of the recording with an arm


@pytest.fixture(scope="module")
def episode(tmp_path_factory) -> Episode:
    device = vrcaps.read_device("magnetic")
    lens = vrcaps.LensEquidistant(focal=6.0, cx=7.5, cy=7.5)
    small = vrcaps.Camera("front", lens, 16, 16, position=(0.0, 0.0, 9e-3))
    motion = Dynamics(
        start=0.5,
        magnet=MagnetSteering(arm="panda", standoff=0.1),
        dynamics="quasi-static",
        settle=0.0,
        substep=1e-3,
    )
    scenario = Scenario(
        GUT,
        replace(device, cameras=(small,)),
        motion=motion,
        frames=2,
        channels=("depth",),
        effects=vrcaps.Effects.none(),
    )
    return read_episode(record(scenario, tmp_path_factory.mktemp("scene") / "episode"))


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
        ("link_4", scene.arm.T_world_base @ placed[3], scene.arm.masses()[3]),
        ("flange", scene.arm.T_world_base @ placed[-1], None),
    ):
        prim = stage.GetPrimAtPath(f"/scene/{name}")
        theirs = np.array(cache.GetLocalToWorldTransform(prim)).T
        np.testing.assert_allclose(theirs, pose, atol=1e-12)
        if mass is not None:
            stated = UsdPhysics.MassAPI(prim).GetMassAttr().Get()
            assert stated == pytest.approx(mass, rel=1e-6)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/scene/wall"))
    points = np.array(mesh.GetPointsAttr().Get())
    np.testing.assert_allclose(points, scene.wall.vertices, atol=1e-6)
    shell = UsdGeom.Capsule(stage.GetPrimAtPath("/scene/capsule/shell"))
    assert shell.GetHeightAttr().Get() == pytest.approx(2 * scene.capsule.half_axis)


def test_what_cannot_be_written_is_one_line(episode, scene, tmp_path):
    with pytest.raises(InputError, match=r"a\.txt: unknown kind of scene\. Allowed: \.xml, \.usda"):
        write_scene(scene, tmp_path / "a.txt")
    with pytest.raises(InputError, match=r"frame is 2\. Allowed: 0 to 1"):
        scene_of(episode, 2)
    with pytest.raises(InputError, match=r"Cannot write .*scene\.xml: No such file"):
        write_scene(scene, tmp_path / "no" / "scene.xml")


def test_the_verb_says_what_it_wrote(episode, tmp_path, capsys):
    commands.Scene(episode.path, tmp_path / "a.xml", frame=1).run()
    assert capsys.readouterr().out == f"Wrote wall, capsule, magnet, arm to {tmp_path / 'a.xml'}.\n"
    assert (tmp_path / "a-wall.obj").is_file()
