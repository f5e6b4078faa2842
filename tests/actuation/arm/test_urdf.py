"""Arms from URDF files: pinocchio's kinematics, collision capsules, and mistakes in one line."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from vrcaps.actuation.arm.arm import Arm, arm_names, forward, jacobian, nearest, read_arm
from vrcaps.actuation.arm.arm_with_payload import ArmWithPayload, clearances
from vrcaps.actuation.arm.urdf import UrdfArm, arm_from_urdf, capsule_around
from vrcaps.actuation.steering_program import MagnetSteering
from vrcaps.core.errors import InputError
from vrcaps.magnet.presets import read_magnet
from vrcaps.motion.dynamics import Dynamics
from vrcaps.scenario.scenario import Scenario, scenario_from_plain, scenario_to_plain

pytest.importorskip("yourdfpy")
pinocchio = pytest.importorskip("pinocchio")
ROBOTS = Path(pinocchio.__file__).parents[4] / "share" / "example-robot-data" / "robots"
FILES = {
    "ur5": (ROBOTS / "ur_description/urdf/ur5_robot.urdf", "tool0", 6),
    "xarm7": (ROBOTS / "xarm_description/urdf/xarm7.urdf", "", 7),
    "panda": (ROBOTS / "panda_description/urdf/panda.urdf", "panda_link8", 7),
}


def read(name: str, *, collision: bool = False) -> Arm:
    file, tool, _ = FILES[name]
    if not file.is_file():
        pytest.skip(f"no {name} from example-robot-data at {file}")
    return arm_from_urdf(UrdfArm(str(file), tool=tool, collision=collision), name=name)


@pytest.mark.parametrize("name", FILES)
def test_forward_and_jacobian_are_pinocchios(name):
    arm, (file, tool, count) = read(name), FILES[name]
    model = pinocchio.buildModelFromUrdf(os.fspath(file))
    data = model.createData()
    flange = model.getFrameId(tool or "link7")
    assert arm.num_joints == count
    angles = np.random.default_rng(0).uniform(arm.lower, arm.upper, (200, count))
    poses, rows = forward(arm, angles), jacobian(arm, angles)
    for q, pose, ours in zip(angles, poses, rows, strict=True):
        full = np.concatenate([q, np.zeros(model.nq - count)])
        world = pinocchio.LOCAL_WORLD_ALIGNED
        theirs = pinocchio.computeFrameJacobian(model, data, full, flange, world)[:, :count]
        pinocchio.framesForwardKinematics(model, data, full)
        assert np.abs(pose - data.oMf[flange].homogeneous).max() < 1e-12
        assert np.abs(ours - theirs).max() < 1e-12
    np.testing.assert_allclose(arm.upper, model.upperPositionLimit[:count])
    np.testing.assert_allclose([j.velocity for j in arm.joints], model.velocityLimit[:count])


@pytest.mark.parametrize("name", [*FILES, "ur5e"])
def test_the_inverse_finds_99_percent_of_reachable_poses(name):
    arm = read_arm(name) if name in arm_names() else read(name)
    rng = np.random.default_rng(1)
    angles = rng.uniform(arm.lower, arm.upper, (300, arm.num_joints))
    targets = forward(arm, angles)
    found = nearest(arm, targets, np.array(arm.home), rng=rng)
    is_found = ~np.isnan(found).any(axis=1)
    assert is_found.mean() >= 0.99
    assert np.abs(forward(arm, found[is_found]) - targets[is_found]).max() < 1e-8
    assert (found[is_found] >= arm.lower).all()
    assert (found[is_found] <= arm.upper).all()


def test_capsules_hold_the_collision_meshes():
    arm = read("ur5", collision=True)
    assert {link.frame for link in arm.links} == set(range(7))
    assert arm.collision_pairs
    robot = ArmWithPayload(arm, read_magnet("cylinder-50.8"), table_height=-0.5)
    folded = np.array([[0.0, 0.0, 2.9, 0.0, 0.0, 0.0]])
    own, table = clearances(robot, np.array([arm.home]))[0]
    assert own > 0.0
    assert table > 0.0
    assert clearances(robot, folded)[0, 0] < 0.0


def test_a_capsule_holds_its_points_and_no_more():
    rng = np.random.default_rng(2)
    points = rng.normal(size=(500, 3)) * [0.02, 0.03, 0.2] + [0.1, 0.0, -0.1]
    link = capsule_around(points, 3)
    start, end = np.array(link.start), np.array(link.end)
    along = np.clip((points - start) @ (end - start) / ((end - start) @ (end - start)), 0.0, 1.0)
    away = np.linalg.norm(points - start - along[:, None] * (end - start), axis=1)
    assert away.max() <= link.radius * (1 + 1e-9)
    ball = points / np.linalg.norm(points, axis=1, keepdims=True)
    assert capsule_around(ball, 0).radius < 1.1


CHAIN = """<robot name="two"><link name="base"/><link name="arm"/><link name="hand"/>
<joint name="one" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<origin xyz="0 0 0.3" rpy="0.1 0.2 0.3"/>
<limit lower="-1" upper="2" velocity="1" effort="5"/></joint>
<joint name="two" type="revolute"><parent link="arm"/><child link="hand"/><axis xyz="0 0 -1"/>
<origin xyz="0.2 0 0"/><limit lower="0.5" upper="2" velocity="1" effort="5"/></joint></robot>"""


INERTIAL = (
    '<link name="hand"><inertial><origin xyz="0 0 1"/><mass value="{mass}"/>'
    '<inertia ixx="{xx}" ixy="0" ixz="0" iyy="2" iyz="0" izz="2"/></inertial></link>'
)


def test_masses_fixed_to_one_frame_are_combined(tmp_path):
    """2 kg at 1 m and 6 kg at −1 m of z; z of frame 2 points along −z of the link."""
    more = INERTIAL.format(mass=6, xx=2).replace("0 0 1", "0 0 -1").replace("hand", "tip")
    bare = '<link name="bare"><inertial><mass value="3"/></inertial></link>'
    joint = '<joint name="{0}" type="fixed"><parent link="hand"/><child link="{0}"/></joint>'
    text = CHAIN.replace('<link name="hand"/>', INERTIAL.format(mass=2, xx=2) + more)
    text = text.replace('<link name="base"/>', '<link name="base"/>' + bare)
    text = text.replace("</robot>", joint.format("tip") + joint.format("bare") + "</robot>")
    (tmp_path / "two.urdf").write_text(text)
    arm = arm_from_urdf(UrdfArm(str(tmp_path / "two.urdf"), tool="tip"), name="two")
    (mass,) = arm.masses
    assert (mass.frame, mass.mass) == (2, 8.0)
    np.testing.assert_allclose(mass.center, (0.0, 0.0, 0.5), atol=1e-12)
    spread = 4.0 + 2.0 * 1.5**2 + 6.0 * 0.5**2
    np.testing.assert_allclose(mass.inertia, (spread, spread, 4.0, 0.0, 0.0, 0.0), atol=1e-12)
    without = UrdfArm(str(tmp_path / "two.urdf"), tool="tip", masses=False)
    assert arm_from_urdf(without, name="two").masses == ()


def test_links_without_inertia_have_the_assumed_one(tmp_path):
    """Also where two are fixed to one frame: as points they would have no inertia about a line."""
    stated = INERTIAL.format(mass=2, xx=2)
    bare = stated[: stated.index("<inertia ")] + "</inertial></link>"
    tip = bare.replace("0 0 1", "0 0 -1").replace("hand", "tip")
    joint = '<joint name="tip" type="fixed"><parent link="hand"/><child link="tip"/></joint>'
    text = CHAIN.replace('<link name="hand"/>', bare + tip)
    (tmp_path / "two.urdf").write_text(text.replace("</robot>", f"{joint}</robot>"))
    (mass,) = arm_from_urdf(UrdfArm(str(tmp_path / "two.urdf"), tool="tip"), name="two").masses
    own = 4.0 * 0.1**2
    np.testing.assert_allclose(mass.inertia, (4.0 + own, 4.0 + own, own, 0, 0, 0), atol=1e-12)


def test_entities_are_refused_in_any_encoding(tmp_path):
    text = '<?xml version="1.0" encoding="UTF-16"?><!DOCTYPE robot [<!ENTITY x "two">]>'
    path = tmp_path / "two.urdf"
    path.write_bytes((text + CHAIN.replace('name="two"', 'name="&x;"', 1)).encode("utf-16"))
    with pytest.raises(
        InputError, match=r"two\.urdf: it is not a URDF file\. Allowed: .* without DOCTYPE"
    ):
        read_arm(path)


def test_settings_of_a_toml_file_and_in_a_scenario(tmp_path):
    (tmp_path / "two.urdf").write_text(CHAIN)
    path = tmp_path / "mine.toml"
    path.write_text('urdf = "two.urdf"\ntool = "hand"\nhome_deg = [10, 40]\npayload_kg = 4\n')
    arm = read_arm(path)
    assert (arm.name, arm.payload) == ("mine", 4.0)
    np.testing.assert_allclose(np.degrees(arm.home), [10, 40])
    plain = read_arm(tmp_path / "two.urdf")
    assert plain.home == (0.0, 0.5)
    scenario = Scenario("stomach", "magnetic", motion=Dynamics(magnet=MagnetSteering(arm=arm)))
    (tmp_path / "two.urdf").unlink()
    assert scenario_from_plain(scenario_to_plain(scenario)).motion.magnet.arm == arm


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (' velocity="1"', "", r"joint one has no limit of velocity\. Add <limit>"),
        ('<limit lower="-1" upper="2" velocity="1" effort="5"/>', "", "lower and upper and vel"),
        ('lower="-1" upper="2"', 'lower="3" upper="2"', r"joint one: upper is 2\. Allowed: above"),
        ('name="two" type="revolute"', 'name="two" type="prismatic"', "joint two is prismatic"),
        ('<child link="hand"/>', '<child link="base"/>', r"closed loop|no joints lead"),
        (
            "</robot>",
            '<joint name="x" type="fixed"><parent link="base"/><child link="hand"/></joint>'
            "</robot>",
            r"link hand is the child of the joints two and x, a closed loop\. Allowed: a tree",
        ),
        ('<link name="hand"/>', "", "joint two connects a link that does not exist"),
        (
            '<link name="hand"/>',
            '<link name="hand"><collision><geometry><mesh filename="package://a/b.stl"/>'
            "</geometry></collision></link>",
            r"mesh package://a/b\.stl of link hand is missing\. Give the folder",
        ),
        (
            '<link name="hand"/>',
            '<link name="hand"><collision><geometry><mesh filename="/etc/passwd"/>'
            "</geometry></collision></link>",
            r"mesh /etc/passwd of link hand is missing",
        ),
        (
            '<link name="hand"/>',
            INERTIAL.format(mass=2, xx=9),
            r"<inertial> after 2 joints: inertia is .* Allowed: positive, and no .* masses = false",
        ),
        (
            '<link name="hand"/>',
            INERTIAL.format(mass=-2, xx=1),
            r"<inertial> of link hand has mass -2, .* Allowed: a mass above 0",
        ),
        (
            '<link name="hand"/>',
            INERTIAL.format(mass=2, xx="nan"),
            r"of link hand has mass 2, ixx to izz nan, .* masses = false",
        ),
        (
            '<link name="hand"/>',
            INERTIAL.format(mass="1e300", xx=2).replace("0 0 1", "0 0 nan"),
            r"of link hand has mass 1e\+300, .* numbers up to 100000",
        ),
        (
            '<link name="hand"/>',
            INERTIAL.format(mass=2, xx=-1),
            r"ixx to izz -1, .* no negative principal moment",
        ),
        ("</robot>", "", r"Cannot read the URDF file"),
        ("robot", "sdf", r"is not a URDF file\. Allowed: the element <robot>"),
        ('<robot name="two">', "<!DOCTYPE x><robot>", r"is not a URDF file\. .*without DOCTYPE"),
        (CHAIN, '<robot name="none"/>', "contains no links"),
    ],
)
def test_a_urdf_that_is_no_arm_is_one_line(tmp_path, old, new, message):
    assert old in CHAIN
    path = tmp_path / "two.urdf"
    path.write_text(CHAIN.replace(old, new))
    with pytest.raises(InputError, match=message) as raised:
        read_arm(path)
    assert "\n" not in str(raised.value)


def test_settings_that_do_not_fit(tmp_path):
    path = tmp_path / "two.urdf"
    path.write_text(CHAIN)
    for settings, message in (
        (UrdfArm(str(path), tool="foot"), r"no link 'foot'\. Known: arm, base, hand"),
        (UrdfArm(str(path), home=(0.0,)), r"home has 1 angles\. Allowed: 2, one for each"),
        (UrdfArm(str(path), base="hand", tool="arm"), "no joints lead from base 'hand'"),
        (UrdfArm(str(tmp_path / "no.urdf")), "Cannot read the URDF file"),
    ):
        with pytest.raises(InputError, match=message):
            arm_from_urdf(settings, name="two")
    two = CHAIN.replace(
        "</robot>",
        '<link name="foot"/><joint name="x" type="revolute"><parent link="arm"/>'
        '<child link="foot"/><limit lower="0" upper="1" velocity="1" effort="1"/></joint></robot>',
    )
    path.write_text(two)
    with pytest.raises(InputError, match=r"has several ends: foot, hand\. State the one"):
        read_arm(path)
    with pytest.raises(InputError, match=r"arm is of type int\. Allowed: a name \(panda, ur5e\)"):
        MagnetSteering(arm=3)
