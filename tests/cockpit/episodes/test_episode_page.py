"""Recorded episodes in a real browser."""

from __future__ import annotations

import shutil
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.cockpit_browser import free_port, wait_until
from tests.support.waiting import WATCHDOG
from vrcaps.cockpit.episode_page import open_episodes
from vrcaps.cockpit.episode_views import RecordedWalls
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import transform_points
from vrcaps.mesh.mesh import Mesh
from vrcaps.organ.read_organ import read_organ
from vrcaps.recording.episode import read_episode
from vrcaps.recording.pictures import picture


def test_says_how_many_episodes_there_may_be(recorded):
    pytest.importorskip("viser", reason="the extra cockpit is not installed")
    for folders in ([], [recorded] * 3):
        with (
            pytest.raises(InputError, match="episodes are given"),
            open_episodes(folders),
        ):
            pass


@pytest.mark.slow
def test_two_episodes_play_side_by_side(browser, recorded, tmp_path):
    """The images are those of the files, at the slider's frame; depth at a click; an estimate's
    error is told, and zero after alignment."""
    episode, path = read_episode(recorded), tmp_path / "slam.txt"
    places = 2.0 * episode.Ts_world_capsule[:, :3, 3] + [0.1, 0.0, 0.0]
    turns = np.tile([0.0, 0.0, 0.0, 1.0], (len(episode), 1))
    np.savetxt(path, np.c_[episode.times, places, turns], fmt="%.12f")
    other = shutil.copytree(recorded, tmp_path / "other")
    damaged = read_episode(other).image_path(episode.cameras[0].name, "rgb", 1)
    damaged.write_bytes(damaged.read_bytes()[:50])
    with open_episodes([recorded, other], estimate=path, port=free_port()) as (page, gate):
        tab = browser.new_page(viewport={"width": 1300, "height": 700}, device_scale_factor=0.3)
        tab.set_default_timeout(1e3 * WATCHDOG)
        tab.goto(gate.address)
        tab.get_by_role("button", name="Play").wait_for()
        images = tab.locator("img[src^='blob:']")
        wait_until(tab, lambda: images.count() == 2)
        area = tab.locator("#cameras").bounding_box()
        sizes = [images.nth(k).bounding_box() for k in range(2)]
        assert sum(each["width"] for each in sizes) > 0.95 * area["width"]
        assert all(each["height"] > 0.95 * area["height"] for each in sizes)
        slider = tab.get_by_label("Frame", exact=True)
        slider.fill("3")
        tab.get_by_text(f"{episode.times[3]:.2f} s · frame 3").nth(1).wait_for()
        expected = picture("rgb", episode.image(episode.cameras[0].name, "rgb", 3))
        for shown in page.pictures:
            np.testing.assert_array_equal(shown, expected)
        tab.get_by_role("button", name="Previous frame").click()
        wait_until(tab, lambda: page.frame == 2)
        slider.fill("1")
        tab.get_by_text("lists all faults").first.wait_for()
        slider.fill("3")
        tab.get_by_text("RMSE").wait_for()
        assert page.estimate.errors.min() > 0.01
        tab.get_by_label("Alignment").select_option("rigid and scale")
        tab.get_by_text("RMSE 0.00 mm").wait_for()
        before = images.first.get_attribute("src")
        tab.get_by_label("Channel").select_option("depth")
        wait_until(tab, lambda: images.first.get_attribute("src") != before)
        axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
        found = axe.run(tab, options={"iframes": False}).response["violations"]
        assert [(each["id"], each["nodes"][0]["html"]) for each in found] == []
        tab.get_by_role("button", name="Play").click()
        last = f"frame {len(episode) - 1}"
        tab.get_by_text(last).nth(1).wait_for()
        tab.get_by_role("button", name="Play").wait_for()
        tab.close()


def test_recorded_walls_are_found_again_by_the_organs_vertices(recorded):
    """The file holds vertices at seams of the texture twice, the organ that is read once."""
    episode = read_episode(recorded)
    organ = read_organ(episode.organ_path)
    rest = transform_points(np.array(episode.head["T_world_patient"]), organ.vertices)

    def wall(frame: int) -> Mesh:
        return replace(episode.organ, vertices=(1.0 + 0.1 * frame) * episode.organ.vertices)

    stored: Any = SimpleNamespace(organ=episode.organ, wall=wall)
    walls = RecordedWalls(stored, rest)
    assert len(rest) < len(episode.organ.vertices)
    for frame in (0, 2):
        np.testing.assert_allclose(walls.at(frame), (1.0 + 0.1 * frame) * rest, atol=1e-6)
