"""`vrcaps bridge`: publish sensors and accept commands over WebSocket."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from tyro.conf import OmitArgPrefixes, Positional, UseAppendAction

from vrcaps.cli.cockpit import Cockpit
from vrcaps.cli.console import console
from vrcaps.cli.record import use_threads
from vrcaps.cli.scenario_flags import ImageFlags, MotionFlags, OrganFlags
from vrcaps.core.errors import require


@dataclass(frozen=True)
class Bridge:
    """Publish a simulated capsule's sensors and accept commands over WebSocket, as rosbridge does.

    Clients of the rosbridge protocol subscribe to images, IMU, magnetometer, joint states and poses
    and publish the velocity or pose of the magnet, or the currents of coils; the messages have the
    layout of vrcaps export ros2-bag. The flags are those of vrcaps record; without any, a robot
    arm's magnet steers the capsule magnetic through a stomach.

    Topics, commands and a client of ten lines: docs/how-to/connect-a-robot.md.

    The server listens on this machine only and refuses web pages. It does not ask for a password:
    with --host 0.0.0.0 everybody in the network can steer.

    For example:
      vrcaps bridge
      vrcaps bridge --organ colon --seed 3 --fps 10 --port 9091
      vrcaps bridge --set motion.coils={} --channels rgb depth
      vrcaps bridge --paused --real-time-factor 0 --duration 60
    """

    scenario: Positional[Path | None] = None
    """Scenario file (TOML, JSON), or the episode.json of an episode."""

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

    organ: OmitArgPrefixes[OrganFlags] = field(default_factory=OrganFlags)  # pyright: ignore
    """The patient: the organ, its lesions and the contents of its lumen."""

    motion: OmitArgPrefixes[MotionFlags] = field(default_factory=MotionFlags)  # pyright: ignore
    """The capsule and its motion."""

    images: OmitArgPrefixes[ImageFlags] = field(default_factory=ImageFlags)  # pyright: ignore
    """Output: images, frames per second, and the seed of all randomness."""

    set: UseAppendAction[tuple[str, ...]] = ()
    """Change any value of the scenario: PATH=VALUE; vrcaps record --list-settings prints all."""

    threads: int | None = None
    """Number of threads; by default all cores."""

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
        asked = Cockpit(
            self.scenario, organ=self.organ, motion=self.motion, images=self._images, set=self.set
        )
        scenario = asked.resolved()
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
