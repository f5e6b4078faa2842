"""Arms as files: all read, and what is wrong is said in one line."""

from __future__ import annotations

import re

import numpy as np
import pytest

from vrcaps.actuation.arm.arm import Arm, arm_names, read_arm
from vrcaps.actuation.arm.kinematics import forward
from vrcaps.core.errors import InputError, UnknownNameError


@pytest.mark.parametrize("name", arm_names())
def test_every_arm_reads_and_rests_clear(name):
    arm = read_arm(name)
    assert arm.name == name
    assert arm.source
    assert np.isfinite(forward(arm, np.array(arm.home))).all()
    assert arm.core.clearance(np.array([arm.home]))[0, 0] > 0


def test_a_users_own_arm(six_joints: Arm):
    assert six_joints.name == "six"
    assert six_joints.num_joints == 6
    np.testing.assert_allclose(six_joints.joints[3].a, -0.3922)


LINK = "\n[[links]]\nframe = {}\nstart_mm = [0, 0, 0]\nend_mm = [0, 0, 100]\nradius_mm = 40\n"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("a_mm = -425", "a_mm = true", "six.toml: joints[2].a_mm is True. Allowed: a number."),
        ("payload_kg = 5", "payload_kg = 0", "six.toml: payload is 0.0. Allowed: above 0"),
        ("title =", "subtitle =", "six.toml: unknown key subtitle. Allowed: name, title, joints"),
        ('title = "An arm of six joints"', "", "six.toml: missing key title: a text."),
        ("title =", 'name = "x"\ntitle =', "Unknown key six.toml: name. The arm is named as"),
        (
            "upper_rad = 6.2",
            "upper_rad = -7",
            "joints[0]: upper is -7. Allowed: above lower, -6.2 rad.",
        ),
        ("torque_nm = 150", "torque_nm = 0", "joints[0]: torque is 0.0. Allowed: above 0"),
        ("home_deg = [0, -90,", "home_deg = [-90,", "6 joints, 5 home angles."),
        ("home_deg = [0,", "home_deg = [360,", "home angle of joint 1 is outside its limits."),
        (
            "home_deg",
            "collision_pairs = [[0, 8]]\nhome_deg",
            "names frame 8 or 0. Allowed: 0 (base) to 7",
        ),
        (
            "home_deg",
            "collision_pairs = [[0]]\nhome_deg",
            "collision_pairs[0] has 1 values. Allowed: 2.",
        ),
        (
            "theta_deg = 0",
            "theta_deg = 0\nmass = 1",
            "six.toml: unknown key joints[0].mass. Allowed: a_mm, d_mm",
        ),
        ("title", "title = ", "is not TOML"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, six_joints_text, old, new, message):
    assert old in six_joints_text
    path = tmp_path / "six.toml"
    path.write_text(six_joints_text.replace(old, new) + LINK.format(1))
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        read_arm(path)
    assert "\n" not in str(caught.value)


def test_a_link_needs_a_frame(tmp_path, six_joints_text):
    path = tmp_path / "six.toml"
    path.write_text(six_joints_text + LINK.format(-1))
    with pytest.raises(InputError, match=r"links\[0\]: frame is -1. Allowed: 0 or more"):
        read_arm(path)


def test_unknown_arms(tmp_path):
    with pytest.raises(UnknownNameError, match=r"No arm named 'pandas'\. Known: panda"):
        read_arm("pandas")
    with pytest.raises(
        InputError, match=r"No arm file at .*none\.toml\. Give a TOML file, or one of"
    ):
        read_arm(tmp_path / "none.toml")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="is not TOML"):
        read_arm(tmp_path / "bytes.toml")
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(InputError, match="No arm file at"):
        read_arm(tmp_path / "folder.toml")
