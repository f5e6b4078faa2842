"""`vrcaps cockpit` and `vrcaps bridge`: drive from a browser, or from another program."""

from __future__ import annotations

import math
import threading
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction

from vrcaps.cli.console import console
from vrcaps.cli.record import Record, use_threads
from vrcaps.cli.scenario_flags import ImageFlags, MotionFlags, OrganFlags
from vrcaps.core.errors import InputError, require, require_extra

if TYPE_CHECKING:
    from vrcaps.scenario.scenario import Scenario


@dataclass(frozen=True)
class _Drive:
    """Scenario of a drive, from a file and flags."""

    scenario: Positional[Path | None] = None
    """Scenario file (TOML, JSON), or the episode.json of an episode."""

    organ: OmitArgPrefixes[OrganFlags] = field(default_factory=OrganFlags)  # pyright: ignore
    """The patient: the organ, its lesions and the contents of its lumen."""

    motion: OmitArgPrefixes[MotionFlags] = field(default_factory=MotionFlags)  # pyright: ignore
    """The capsule and its motion."""

    images: OmitArgPrefixes[ImageFlags] = field(default_factory=ImageFlags)  # pyright: ignore
    """Images, frames per second, and the seed of all randomness."""

    set: UseAppendAction[tuple[str, ...]] = ()
    """Change any value of the scenario: PATH=VALUE; vrcaps record --list-settings prints all."""

    threads: int | None = None
    """Number of threads; by default all cores."""

    def resolved(self) -> Scenario:
        """Scenario of file and flags; by default a stomach and a magnetic capsule.

        Raises:
            InputError: If a value is invalid, or recorded commands are given.
        """
        flags = {**vars(self.organ), **vars(self.motion)}
        if flags["steer"] is not None:
            raise InputError(
                "--steer replays recorded commands, which a drive does not support. Omit it, or "
                "pass it to vrcaps record."
            )
        organ, motion, steps = self.organ, self.motion, ()
        stated = self._stated_motion()
        if flags["motion"] is None and stated.get("kind") != "dynamics":
            # The flags are checked against the motion of the drive, see `cockpit_scenario`.
            start = stated.get("start") if flags["start"] is None else flags["start"]
            motion = replace(motion, motion="dynamics", start=start)
            steps = ("motion.substep=0.0002",)
        if self.scenario is None and flags["organ"] is None:
            organ = replace(organ, organ="stomach")
        if self.scenario is None and flags["capsule"] is None:
            motion = replace(motion, capsule="magnetic")
        asked = Record(self.scenario, None, organ, motion, self._images, (*steps, *self.set))
        return asked.resolved()

    def _stated_motion(self) -> dict[str, Any]:
        """Motion of the scenario file as plain values; empty without one."""
        from vrcaps.scenario.scenario import read_plain_scenario

        plain = {} if self.scenario is None else read_plain_scenario(self.scenario)
        motion = plain.get("motion") if isinstance(plain, dict) else None
        return motion if isinstance(motion, dict) else {}

    @property
    def _images(self) -> Any:
        """Flags of images, of which a subclass may change the defaults."""
        return self.images


@dataclass(frozen=True)
class Cockpit(_Drive):
    """Drive a capsule by magnet or coils from a browser, and save the drive.

    The page shows organ, capsule, magnet and arm, and the image of the capsule's camera. Drag the
    magnet, hold keys or use a gamepad. The flags are those of vrcaps record; without any, a robot
    arm's magnet steers the capsule magnetic through a stomach.

    The drive is saved to a folder every second: commands.csv, and drive.json, which records the
    drive as an episode: vrcaps record FOLDER/drive.json --out EPISODE.

    The page opens only with the printed address: it contains a token, which every request needs and
    the browser stores as a cookie. The server listens on this machine only. From elsewhere, forward
    the port (ssh -L 8080:localhost:8080 MACHINE), or use --host 0.0.0.0.

    For example:
      vrcaps cockpit
      vrcaps cockpit --organ colon --seed 3 --lesions prevalence --out runs/drive
      vrcaps cockpit --motion dynamics --set motion.magnet.wall=upper
      vrcaps cockpit --set motion.coils.coils=coils.toml
      vrcaps cockpit --policy mine.policies:Mine --policy runs/policy/best.npz
    """

    out: Path | None = None
    """New or empty folder for the drive; by default runs/drive-DATE-TIME."""

    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 also admits other machines."""

    port: int = 8080
    """Port to listen on."""

    policy: UseAppendAction[tuple[str, ...]] = ()
    """Policy to offer in the page besides the baselines: a trained policy's file, or an import path
    package.module:Class; repeat for more."""

    def run(self) -> None:
        """Serve the page until Ctrl-C.

        Raises:
            InputError: If the scenario is invalid, the folder not empty or the port in use.
        """
        use_threads(self.threads)
        require_extra("cockpit", "viser", "gymnasium", "trimesh")
        from vrcaps.cockpit.cockpit import open_cockpit
        from vrcaps.cockpit.server import require_free

        require_free(self.host, self.port)
        out = self.out or Path("runs") / time.strftime("drive-%Y%m%d-%H%M%S")
        with open_cockpit(
            self.resolved(),
            out,
            host=self.host,
            port=self.port,
            policies=self.policy,
            on_message=console.print,
        ) as cockpit:
            console.print(f"Open {cockpit.gate.address} in a browser; Ctrl-C ends the drive.")
            console.print(f"The drive is saved in {out}.")
            try:
                threading.Event().wait()
            except KeyboardInterrupt:
                console.print("Stopping …")
        console.print(f"Record it with: vrcaps record {out / 'drive.json'} --out EPISODE")


@dataclass(frozen=True)
class Bridge(_Drive):
    """Publish a simulated capsule's sensors and accept commands over WebSocket, as rosbridge does.

    Clients of the rosbridge protocol subscribe to images, IMU, magnetometer, joint states and poses
    and publish the velocity or pose of the magnet, or the currents of coils; the messages have the
    layout of vrcaps export ros2-bag. The flags are those of vrcaps record; without any, a robot
    arm's magnet steers the capsule magnetic through a stomach.

    Topics, commands and a client of ten lines: docs/how-to/connect-a-robot.md.

    The server listens on this machine only and rejects web pages. It does not ask for a password:
    with --host 0.0.0.0 anyone on the network can steer.

    For example:
      vrcaps bridge
      vrcaps bridge --organ colon --seed 3 --fps 10 --port 9091
      vrcaps bridge --set motion.coils={} --channels rgb depth
      vrcaps bridge --paused --real-time-factor 0 --duration 60
    """

    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 also admits other machines."""

    port: int = 9090
    """Port to listen on."""

    allow_origin: UseAppendAction[tuple[str, ...]] = ()
    """Origin of a web page that may connect, such as http://localhost:3000; repeat for more."""

    real_time_factor: float = 1.0
    """Simulated time per real time, if the machine is fast enough; 0 is as fast as possible."""

    paused: bool = False
    """Wait for the service /step_simulation before each frame: the same commands then give the same
    messages."""

    rectify: float | None = None
    """Resample images to a pinhole with this horizontal field of view [degrees], below 180; 90 by
    default for a lens that ROS cannot describe."""

    duration: float = math.inf
    """Simulated time after which to end [s]; by default at Ctrl-C."""

    def run(self) -> None:
        """Simulate until Ctrl-C or the end of the duration.

        Raises:
            InputError: If the scenario is invalid or the port in use.
            MissingExtraError: If websockets is not installed.
        """
        use_threads(self.threads)
        require(self.duration >= 0.0, "--duration", f"{self.duration:g} s", "0 s or more")
        from vrcaps.cockpit.bridge.simulation import LiveSimulation, open_bridge
        from vrcaps.cockpit.server import require_free

        require_free(self.host, self.port)
        scenario = self.resolved()
        console.print("Generating organ and world …")
        simulation = LiveSimulation(
            scenario,
            real_time_factor=self.real_time_factor,
            is_paused=self.paused,
            field_of_view=None if self.rectify is None else math.radians(self.rectify),
        )
        for note in simulation.notes:
            console.print(f"Note: {note}")
        with open_bridge(
            simulation,
            host=self.host,
            port=self.port,
            origins=self.allow_origin,
            on_message=console.print,
        ) as server:
            console.print(f"Connect to ws://{self.host}:{self.port}; Ctrl-C ends the simulation.")
            console.print(f"Published: {', '.join(simulation.kinds)}.")
            console.print(f"Commands: {', '.join(simulation.commands.kinds)}.")
            try:
                end = simulation.run(server.publish, lambda: server.wanted, self.duration)
                console.print(f"Ended at {end:.3f} s.")
            except KeyboardInterrupt:
                console.print("Stopped.")

    @property
    def _images(self) -> Any:
        """Flags of images; color only, unless a file or flag says otherwise."""
        if self.scenario is None and self.images.channels is None:
            return replace(self.images, channels=("rgb",))
        return self.images
