"""Page of a drive without a simulation: the same page and server, with values that stand still."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from tests.support.cockpit_browser import free_port
from vrcaps.cockpit import messages
from vrcaps.cockpit.driving.drive_setup import CONTROLS, QUANTITIES, SPEEDS
from vrcaps.cockpit.page import FieldError, Page
from vrcaps.cockpit.scene.nodes import CUTS
from vrcaps.cockpit.scene.viewpoint import aim
from vrcaps.cockpit.server import Gate, make_gate, serving
from vrcaps.world.model import POSTURES, posture_transform

NEW_DRIVE = {
    **{"organs": ["colon", "stomach"], "organ": "stomach", "seed": 0},
    **{"capsules": ["magnetic"], "capsule": "magnetic"},
    **{"magnets": ["cylinder-76.2"], "magnet": "cylinder-76.2"},
    **{"arms": ["none", "panda"], "arm": "panda"},
    **{"coilArrays": ["none", "table-3x3"], "coils": "none"},
    "severities": [{"name": "chyme", "label": "chyme", "hint": "Chyme", "severity": 0}],
}


def history() -> list[list[float]]:
    """Half a minute of readings that are noise around a value, as of a resting capsule."""
    generator = np.random.default_rng(0)
    noise = 1e-3 * generator.standard_normal((300, len(QUANTITIES)))
    return [[0.1 * k, *(20.0 + row)] for k, row in enumerate(noise)]


class StillPage(Page):
    """Page that notes commands.

    Attributes:
        commands: What the browsers have sent.
        values: Current values; may be changed.
    """

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.commands: list[messages.Command] = []
        self._handle(
            {
                command: lambda client, given: self.commands.append(given)
                for command in messages.Command.__subclasses__()
                if command is not messages.FrameView
            }
            | {messages.NewDrive: self._new_drive}
        )
        self.values: dict[str, Any] = {
            **{"driver": 1, "policy": "", "speed": 1.0, "snapshots": [], "isBusy": False},
            **{"recording": {"state": "none"}, "readings": [20.0] * len(QUANTITIES)},
            **{"coverage": 9.3, "mapPlace": (0.3, 0.4), "segment": "antrum", "imageRate": 24.0},
            **{"leavesOutShadows": False, "camera": "front", "channel": "rgb"},
            **{"light": "direct", "imaging": "white-light", "alwaysShadows": False},
            **{"effects": {"noise": 1}, "legend": [((119, 170, 221), "antrum")]},
            "scene": {"coloring": "segment", "opacity": 0.6, "cut": "capsule", "cut_fraction": 0.5}
            | {"has_lines": True, "has_patient": True},
            **{"hasContents": False, "time": 30.0, "isSettling": False, "frame": 120},
            **{"isPaused": False, "achievedSpeed": 0.98, "isSteering": False},
            **{"limit": "its maximum speed", "lost": ""},
        }

    def setup(self) -> dict[str, Any]:
        """Constants of the page."""
        return {
            **{"folder": "runs/drive", "fps": 4.0, "channels": ["rgb", "depth"]},
            "cameras": [{"name": name, "width": 320, "height": 320} for name in ("front", "rear")],
            "speeds": [{"label": f"{label} ×", "value": value} for label, value in SPEEDS.items()],
            **{"policies": ["navigator"], "controls": CONTROLS, "coils": []},
            **{"postures": list(POSTURES), "posture": "supine", "lights": ["direct", "path"]},
            **{"imagings": ["white-light", "narrow-band"], "maxSeverity": 4},
            "liveEffects": [{"name": "noise", "label": "noise", "hint": "Noise of the sensor"}],
            **{"colorings": ["segment", "coverage"], "chartSpan": 60.0, "newDrive": NEW_DRIVE},
            "cuts": [{"value": name, "label": label} for name, label in CUTS.items()],
            "quantities": [quantity.plain() for quantity in QUANTITIES],
            "segments": [{"name": "antrum", "start": 0.0, "end": 1.0}],
            "history": history(),
        }

    def status(self) -> dict[str, Any]:
        """Current values of the page."""
        return dict(self.values)

    def update(self) -> None:
        """Do nothing."""

    def box(self, target: str) -> tuple[np.ndarray, np.ndarray]:
        """A box of 10 cm."""
        return np.full(3, -0.05), np.full(3, 0.05)

    def T_world_patient(self) -> np.ndarray:
        """A patient who lies on the back."""
        return posture_transform("supine")

    def _new_drive(self, client: int, command: messages.NewDrive) -> None:
        if command.lesions:
            raise FieldError("lesions", "No lesion named 'wart'. Known: polyp.")
        self.commands.append(command)


@contextmanager
def still_page() -> Iterator[tuple[StillPage, Gate]]:
    """Serve the page within a `with` block."""
    gate = make_gate("127.0.0.1", free_port())
    with serving(gate, lambda text: None) as (server, hub):
        aim(server, np.full(3, -0.1), np.full(3, 0.1))
        page = StillPage(server, hub, lambda text: None)
        page.show_image("camera", np.full((64, 64, 3), 120, np.uint8))
        page.show_image("map", np.full((16, 48, 3), 90, np.uint8))
        page.start()
        try:
            yield page, gate
        finally:
            page.close()
