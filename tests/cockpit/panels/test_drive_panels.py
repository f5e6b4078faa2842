"""Policies that browsers may choose: baselines, and those of the command line."""

from __future__ import annotations

from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

from vrcaps.cockpit.panels.drive_panels import PolicyPanel
from vrcaps.core.errors import InputError, UnknownNameError


def test_a_policy_that_was_not_allowed_is_not_imported() -> None:
    page = MagicMock(policies=("mine.policies:Mine", "navigator"))
    page.session.operator = SimpleNamespace(policy="")
    panel = PolicyPanel(page)
    (_, names), options = page.server.gui.add_dropdown.call_args
    assert names[-1] == "mine.policies:Mine"
    assert names.count("navigator") == 1
    assert options["initial_value"] == "navigator"
    for name in ("os:abort", "/etc/passwd", ""):
        panel._name.value = name
        with pytest.raises(UnknownNameError, match=r"Known: .*mine\.policies:Mine"):
            panel._toggle()


def test_a_policy_of_the_command_line_is_checked_before_the_page_opens(
    drive_scenario, tmp_path
) -> None:
    pytest.importorskip("viser", reason="the extra cockpit is not installed")
    from vrcaps.cockpit.cockpit import open_cockpit

    with pytest.raises(InputError, match="os:abort is not a policy"):
        open_cockpit(drive_scenario, tmp_path / "drive", policies=("os:abort",)).__enter__()
    assert list(tmp_path.iterdir()) == []
