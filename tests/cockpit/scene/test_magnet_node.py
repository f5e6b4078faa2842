"""Meshes of an arm's links: as its package has them, and plain where there is none."""

from __future__ import annotations

import numpy as np
import pytest

from vrcaps.actuation.arm.arm import read_arm
from vrcaps.cockpit.scene import magnet_node
from vrcaps.cockpit.scene.magnet_node import link_meshes


@pytest.mark.parametrize("is_installed", [False, True])
def test_each_link_is_drawn_in_its_frame(is_installed, monkeypatch):
    """The package's links fill the capsules that the arm's file has around them."""
    arm = read_arm("panda")
    if not is_installed:
        monkeypatch.setattr(magnet_node, "_PREFIXES", ("nowhere",))
    elif magnet_node._description("panda", 0) is None:
        pytest.skip("example-robot-data is not installed")
    meshes = link_meshes(arm)
    assert set(range(8)) >= set(meshes) - {8}
    for link in arm.links:
        if link.frame in meshes:
            vertices, faces = meshes[link.frame]
            assert faces.max() < len(vertices)
            middle = np.mean([link.start, link.end], axis=0)
            assert np.linalg.norm(vertices - middle, axis=1).min() < 2.5 * link.radius
