"""`vrcaps cockpit`: drive the capsule from a browser."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction

from vrcaps.cli.console import console
from vrcaps.cli.record import Record
from vrcaps.cli.recording import use_threads
from vrcaps.cli.scenario_flags import ImageFlags, MotionFlags, OrganFlags
from vrcaps.errors import InputError

if TYPE_CHECKING:
    from vrcaps.scenario.scenario import Scenario


@dataclass(frozen=True)
class Cockpit:
    """Drive a capsule by magnet from a browser, and keep what was driven.

    The page shows organ, capsule, magnet and arm, and what the capsule's camera sees. Drag the
    magnet, hold keys or use a gamepad. The flags are those of vrcaps record; without any, a robot
    arm's magnet leads the capsule magnetic through a stomach.

    What is driven is kept in a folder, each second: commands.csv, and drive.json, which records the
    drive as an episode: vrcaps record FOLDER/drive.json --out EPISODE.

    Only the address that is printed opens the page: it holds a token, without which nothing is
    served, and which the browser keeps as a cookie. The page is served to this machine only. From
    elsewhere, forward the port (ssh -L 8080:localhost:8080 MACHINE), or give --host 0.0.0.0.

    For example:
      vrcaps cockpit
      vrcaps cockpit --organ colon --seed 3 --lesions prevalence --out runs/drive
      vrcaps cockpit --motion dynamics --set motion.magnet.wall=upper
      vrcaps cockpit --policy mine.policies:Mine --policy runs/policy/best.npz
    """

    scenario: Positional[Path | None] = None
    """Scenario file (TOML, JSON), or the episode.json of an episode."""

    out: Path | None = None
    """New or empty folder for what is driven; by default runs/drive-DATE-TIME."""

    host: str = "127.0.0.1"
    """Address to listen at; 0.0.0.0 lets other machines in, too."""

    port: int = 8080
    """Port to listen at."""

    policy: UseAppendAction[tuple[str, ...]] = ()
    """A policy that the page offers beside the baselines: the file of a trained one, or an import
    path package.module:Class; repeat for more."""

    organ: OmitArgPrefixes[OrganFlags] = field(default_factory=OrganFlags)  # pyright: ignore
    """The patient: the organ, its lesions and what is in its lumen."""

    motion: OmitArgPrefixes[MotionFlags] = field(default_factory=MotionFlags)  # pyright: ignore
    """The capsule and how it moves."""

    images: OmitArgPrefixes[ImageFlags] = field(default_factory=ImageFlags)  # pyright: ignore
    """What is written when the drive is recorded, and everything random by one seed."""

    set: UseAppendAction[tuple[str, ...]] = ()
    """Change any value of the scenario: PATH=VALUE; vrcaps record --list-settings prints all."""

    threads: int | None = None
    """Threads to use; by default all cores."""

    def run(self) -> None:
        """Serve the page until Ctrl-C.

        Raises:
            InputError: If the scenario is not possible, the folder not empty or the port in use.
        """
        use_threads(self.threads)
        from vrcaps.cockpit.cockpit import open_cockpit, require_viser

        require_viser()
        out = self.out or Path("runs") / time.strftime("drive-%Y%m%d-%H%M%S")
        console.print("Making organ and world …")
        with open_cockpit(
            self.resolved(),
            out,
            host=self.host,
            port=self.port,
            policies=self.policy,
            say=console.print,
        ) as cockpit:
            console.print(f"Open {cockpit.gate.address} in a browser; Ctrl-C here ends the drive.")
            console.print(f"The drive is kept in {out}.")
            try:
                threading.Event().wait()
            except KeyboardInterrupt:
                console.print("Ending.")
        console.print(f"Record it with: vrcaps record {out / 'drive.json'} --out EPISODE")

    def resolved(self) -> Scenario:
        """The scenario of file and flags; a stomach and a capsule with a magnet by default.

        Raises:
            InputError: If a value is impossible, or recorded commands are given.
        """
        flags = {**vars(self.organ), **vars(self.motion)}
        if flags["steer"] is not None:
            raise InputError(
                "--steer plays recorded commands back, but here you steer. Leave it out, or give "
                "it to vrcaps record."
            )
        organ, motion, steps = self.organ, self.motion, ()
        stated = self._stated_motion()
        if flags["motion"] is None and stated.get("kind") != "dynamics":
            # The flags are checked against the motion that is driven, see `cockpit_scenario`.
            start = stated.get("start") if flags["start"] is None else flags["start"]
            motion = replace(motion, motion="dynamics", start=start)
            steps = ("motion.substep=0.0002",)
        if self.scenario is None and flags["organ"] is None:
            organ = replace(organ, organ="stomach")
        if self.scenario is None and flags["capsule"] is None:
            motion = replace(motion, capsule="magnetic")
        asked = Record(self.scenario, None, organ, motion, self.images, (*steps, *self.set))
        return asked.resolved()

    def _stated_motion(self) -> dict[str, Any]:
        """The motion of the scenario file as plain values; empty without one."""
        from vrcaps.scenario.scenario import read_plain_scenario

        plain = {} if self.scenario is None else read_plain_scenario(self.scenario)
        motion = plain.get("motion") if isinstance(plain, dict) else None
        return motion if isinstance(motion, dict) else {}
