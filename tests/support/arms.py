"""Two robot arms."""

from __future__ import annotations

import pytest

from vrcaps.actuation.arm.arm import Arm, read_arm

SIX_JOINTS = """
title = "An arm of six joints"
flange_offset_mm = [0, 0, 99.6]
payload_kg = 5
home_deg = [0, -90, 90, -90, -90, 0]
"""
JOINT = """
[[joints]]
a_mm = {a}
d_mm = {d}
alpha_deg = {alpha}
theta_deg = 0
lower_rad = -6.2
upper_rad = 6.2
velocity_rad_per_s = 3.14
acceleration_rad_per_s2 = 10
jerk_rad_per_s3 = 1000
torque_nm = 150
"""
ROWS = ((0, 162.5, 0), (0, 0, 90), (-425, 0, 0), (-392.2, 133.3, 0), (0, 99.7, 90), (0, 0, -90))


@pytest.fixture(scope="session")
def panda() -> Arm:
    return read_arm("panda")


@pytest.fixture(scope="session")
def six_joints_text() -> str:
    """A user's own arm: offsets like a UR5e's, so that the wrist is not spherical."""
    return SIX_JOINTS + "".join(JOINT.format(a=a, d=d, alpha=alpha) for a, d, alpha in ROWS)


@pytest.fixture(scope="session")
def six_joints(tmp_path_factory: pytest.TempPathFactory, six_joints_text: str) -> Arm:
    path = tmp_path_factory.mktemp("arm") / "six.toml"
    path.write_text(six_joints_text)
    return read_arm(path)
