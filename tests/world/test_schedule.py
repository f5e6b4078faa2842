"""Commands in time: closed forms of what is between the entries, and every wrong entry."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.geometry import rotation_vector
from vrcaps.world.model import posture_transform
from vrcaps.world.schedule import (
    WRENCH_COLUMNS,
    Flush,
    Insufflation,
    PostureChange,
    Wrench,
    check_flushes,
    check_insufflation,
    check_posture_changes,
    check_wrenches,
    flush_between,
    in_world,
    insufflation_at,
    patient_at,
    read_wrenches,
    wrench_at,
)

HEAD = ",".join(WRENCH_COLUMNS)
RAMP = (Wrench(1.0, (1.0, 0.0, -2.0)), Wrench(3.0, (3.0, 4.0, 0.0), (0.0, 0.0, 1e-3)))


def test_wrenches_are_linear_between_and_constant_beyond() -> None:
    np.testing.assert_allclose(wrench_at(RAMP, 0.0), [[1.0, 0.0, -2.0], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(wrench_at(RAMP, 2.0), [[2.0, 2.0, -1.0], [0.0, 0.0, 5e-4]])
    np.testing.assert_allclose(wrench_at(RAMP, 9.0), [[3.0, 4.0, 0.0], [0.0, 0.0, 1e-3]])
    np.testing.assert_array_equal(wrench_at((), 1.0), np.zeros((2, 3)))


def test_a_flush_gets_on_evenly_while_it_lasts() -> None:
    flushes = (Flush(1.0, 2.0), Flush(5.0, 1.0))
    steps = [(0.9, 1.0), (0.9, 1.1), (1.9, 2.0), (2.9, 3.1), (3.0, 3.1), (5.4, 5.5)]
    shares = [flush_between(flushes, *step) for step in steps]
    np.testing.assert_allclose(shares, [0.0, 0.05, 0.5, 1.0, 0.0, 0.5], atol=1e-12)


@pytest.mark.parametrize("flush", [Flush(0.0, 0.0), Flush(np.inf), Flush(0.0, np.inf)])
def test_rejects_impossible_flushes(flush: Flush) -> None:
    with pytest.raises(InputError, match=r"flushes: entry 0 takes .* Allowed: above 0 s"):
        check_flushes((flush,), "flushes")
    with pytest.raises(InputError, match="does not come after"):
        check_flushes((Flush(2.0), Flush(1.0)), "flushes")


def test_fillings_are_linear_between_and_constant_beyond() -> None:
    insufflation = (Insufflation(1.0, 0.8), Insufflation(3.0, 1.2))
    assert [insufflation_at(insufflation, t) for t in (0.0, 2.0, 5.0)] == pytest.approx(
        [0.8, 1.0, 1.2]
    )
    assert insufflation_at((), 1.0) == 1.0


def test_a_turn_takes_the_shortest_way_and_begins_and_ends_at_rest() -> None:
    first = posture_transform("supine")
    posture_changes = (
        PostureChange("left-lateral", time=1.0, duration=2.0),
        PostureChange("prone", time=4.0, duration=1.0),
    )
    left, prone = (posture_transform(name) for name in ("left-lateral", "prone"))
    np.testing.assert_array_equal(patient_at(first, posture_changes, 0.5), first)
    np.testing.assert_allclose(patient_at(first, posture_changes, 3.5), left, atol=1e-15)
    np.testing.assert_allclose(patient_at(first, posture_changes, 9.0), prone, atol=1e-15)
    whole = rotation_vector(first[:3, :3], left[:3, :3])
    half = rotation_vector(first[:3, :3], patient_at(first, posture_changes, 2.0)[:3, :3])
    np.testing.assert_allclose(half, 0.5 * whole, atol=1e-12)
    step = 1e-4
    for time, speed in ((1.0, 0.0), (3.0, 0.0), (2.0, 1.5 / 2.0)):  # x²(3 − 2x) has slope 1.5
        poses = [patient_at(first, posture_changes, time + d)[:3, :3] for d in (-step, step)]
        rate = np.linalg.norm(rotation_vector(*poses)) / (2.0 * step)
        assert rate == pytest.approx(speed * np.linalg.norm(whole), abs=1e-3)


def test_a_wrench_in_another_frame(rng: np.random.Generator) -> None:
    """Along the axes of a frame that stands on its side."""
    pose = np.eye(4)
    pose[:3, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    pose[:3, 3] = rng.normal(size=3)
    expected = [[3.0, 1.0, 2.0], [6.0, 4.0, 5.0]]
    np.testing.assert_allclose(in_world(np.arange(1.0, 7.0).reshape(2, 3), pose), expected)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_a_table_of_wrenches_is_read(encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "pull.csv"
    rows = [(w.time, *w.force, *w.torque) for w in RAMP]
    np.savetxt(path, rows, "%.6g", ",", header=HEAD, comments="", encoding=encoding)
    assert read_wrenches(path) == RAMP


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "starts with '', not the header time_s,fx_n"),
        ("time,fx\n", "starts with 'time,fx', not the header"),
        (HEAD + "\n", "contains no row of wrenches"),
        (HEAD + "\n0,1,2,3\n", "line 2 is not a row of 7 numbers"),
        (HEAD + "\n0,1,2,3,a,5,6\n", "line 2 is not a row of 7 numbers"),
        (HEAD + "\n0,1,2,3,nan,5,6\n", "entry 0 is not finite"),
        (HEAD + "\n1,1,2,3,4,5,6\n1,1,2,3,4,5,6\n", "time 1 s does not come after 1 s"),
    ],
)
def test_wrong_tables(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "pull.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=re.escape(message)):
        read_wrenches(path)


@pytest.mark.parametrize("cut", ["1", "1,2,3,4,5,6,", "1,2,3,4,5e-", "1,2"])
def test_a_last_line_that_a_killed_process_cut_off_is_left_out(cut: str, tmp_path: Path) -> None:
    path = tmp_path / "pull.csv"
    path.write_text(f"{HEAD}\n0,1,2,3,4,5,6\n{cut}")
    with pytest.warns(UserWarning, match="the last line is truncated"):
        assert read_wrenches(path) == (Wrench(0.0, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0)),)
    path.write_text(f"{HEAD}\n0,1,2,3,4,5,6\n1,1,2,3,4,5,6")
    assert [wrench.time for wrench in read_wrenches(path)] == [0.0, 1.0]


def test_a_table_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="Cannot read the wrenches"):
        read_wrenches(tmp_path / "none.csv")


def test_wrong_entries() -> None:
    with pytest.raises(InputError, match="wrenches: entry 1 is not finite"):
        check_wrenches((Wrench(), Wrench(1.0, (np.inf, 0.0, 0.0))), "wrenches")
    with pytest.raises(
        InputError, match=r"insufflation: entry 0 is 3.0 at 0.0 s. Allowed: factors"
    ):
        check_insufflation((Insufflation(0.0, 3.0),), "insufflation")
    with pytest.raises(InputError, match=r"time 1 s does not come after 2 s"):
        check_insufflation((Insufflation(2.0), Insufflation(1.0)), "insufflation")
    with pytest.raises(UnknownNameError, match="No posture named 'upside'"):
        check_posture_changes((PostureChange("upside"),), "posture_changes")
    with pytest.raises(InputError, match=r"starts at -1.0 s. Allowed: 0 s or later"):
        check_posture_changes((PostureChange("prone", time=-1.0),), "posture_changes")
    with pytest.raises(InputError, match=r"takes 0.0 s. Allowed: above 0 s"):
        check_posture_changes((PostureChange("prone", duration=0.0),), "posture_changes")
    with pytest.raises(InputError, match=r"turn to supine starts at 2 s, before the one to prone"):
        check_posture_changes(
            (PostureChange("prone", time=0.0, duration=5.0), PostureChange("supine", time=2.0)),
            "posture_changes",
        )
