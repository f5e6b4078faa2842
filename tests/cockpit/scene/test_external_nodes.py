"""Meshes of an arm's links, from its package or plain, and the schematic patient."""

from __future__ import annotations

from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest

from vrcaps.actuation.arm.arm import read_arm
from vrcaps.actuation.coil_array import read_coil_array
from vrcaps.cockpit.scene import external_nodes
from vrcaps.cockpit.scene.external_nodes import (
    CoilNodes,
    MagnetNode,
    coil_mesh,
    link_meshes,
    patient_outline,
)
from vrcaps.core.geometry import transform_from
from vrcaps.magnet.presets import read_magnet
from vrcaps.magnet.sources import Sphere

STOMACH = np.array([[-0.04, -0.09, 0.05], [0.11, 0.06, 0.22], [0.03, 0.0, 0.12]])


@pytest.mark.parametrize("is_installed", [False, True])
def test_each_link_is_drawn_in_its_frame(is_installed, monkeypatch):
    """The package's links fill the capsules that the arm's file has around them."""
    arm = read_arm("panda")
    if not is_installed:
        monkeypatch.setattr(external_nodes, "_PREFIXES", ("nowhere",))
    elif external_nodes._description("panda", 0) is None:
        pytest.skip("example-robot-data is not installed")
    meshes = link_meshes(arm)
    assert set(range(8)) >= set(meshes) - {8}
    for link in arm.links:
        if link.frame in meshes:
            vertices, faces = meshes[link.frame]
            assert faces.max() < len(vertices)
            middle = np.mean([link.start, link.end], axis=0)
            assert np.linalg.norm(vertices - middle, axis=1).min() < 2.5 * link.radius


def test_coils_are_drawn_where_they_are_and_colored_by_their_currents():
    array = read_coil_array("table-3x3")
    program = MagicMock(array=array, T_world_array=transform_from(np.eye(3), [0.0, 0.0, -0.2]))
    scene = MagicMock()
    scene.add_mesh_simple.side_effect = lambda *args, **more: SimpleNamespace(
        position=np.zeros(3), wxyz=np.array([1.0, 0.0, 0.0, 0.0]), color=None
    )
    nodes = CoilNodes(scene, program)
    vertices, faces = coil_mesh(array.coils[0])
    coil = array.coils[0]
    assert np.ptp(vertices[:, 2]) == pytest.approx(coil.length)
    radii = np.linalg.norm(vertices[:, :2], axis=1)
    assert radii.max() == pytest.approx(coil.radius + coil.thickness / 2)
    assert radii.min() == pytest.approx(coil.radius - coil.thickness / 2)
    assert faces.max() < len(vertices)
    assert nodes.box[1][2] < -0.2
    currents = np.zeros(9)
    currents[:2] = 60.0, -120.0
    nodes.show(currents)
    colors = [handle.color for handle in nodes._handles]
    assert colors[:2] == [(210, 60, 50), (60, 130, 210)]
    assert set(colors[2:]) == {(128, 116, 100)}


@pytest.mark.parametrize("magnet", [read_magnet("cylinder-50.8"), Sphere(0.03, 1.4)])
def test_a_magnet_is_drawn_in_two_halves_that_meet_in_the_middle(magnet):
    scene = MagicMock()
    node = MagnetNode(scene, magnet)
    drawn = {call.args[0]: call.args[1] for call in scene.add_mesh_simple.call_args_list}
    assert drawn["/magnet/south"][:, 2].max() == pytest.approx(0.0)
    assert drawn["/magnet/north"][:, 2].min() == pytest.approx(0.0)
    farthest = max(np.linalg.norm(points, axis=1).max() for points in drawn.values())
    assert node.radius == pytest.approx(farthest)


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (0.15, -0.3, -1.2)])
def test_the_trunk_encloses_the_organ_at_its_height(offset):
    organ = STOMACH + np.array(offset)
    lines = patient_outline(organ)
    assert lines.shape[1:] == (2, 3)
    assert np.ptp(lines[..., 2]) == pytest.approx(1.73)
    near = lines.reshape(-1, 3)
    height = np.abs(near[:, 2] - organ[:, 2].mean()) < 0.1
    assert (near[height].min(axis=0) < organ.min(axis=0))[:2].all()
    assert (near[height].max(axis=0) > organ.max(axis=0))[:2].all()


def test_left_and_right_are_alike_and_a_large_organ_widens_the_trunk():
    lines = patient_outline(STOMACH)
    ends = np.sort(lines.reshape(-1, 3)[:, 0])
    np.testing.assert_allclose(ends, -ends[::-1], atol=1e-12)
    wide = patient_outline(STOMACH * (2.5, 1.0, 1.0))
    assert wide[..., 0].max() > 1.2 * lines[..., 0].max()
    np.testing.assert_allclose(wide[..., 2], lines[..., 2] + wide[0, 0, 2] - lines[0, 0, 2])
