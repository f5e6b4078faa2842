"""Live simulation: steps a rollout, paces it, and publishes the messages of each frame."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from vrcaps.actuation.magnet_actuator import RobotActuator
from vrcaps.camera_pipeline.capsule_cameras import CapsuleCameras
from vrcaps.cockpit.bridge.commands import ArmCommands, CoilCommands, Commands, MagnetCommands
from vrcaps.cockpit.bridge.server import BridgeServer, Respond, serving
from vrcaps.cockpit.session.camera_images import LIVE_CHANNELS
from vrcaps.cockpit.session.clock import Clock
from vrcaps.cockpit.session.drive import cockpit_scenario, require_drivable
from vrcaps.core.errors import InputError, require
from vrcaps.formats.robotics.foxglove_schemas import time_ns
from vrcaps.formats.robotics.ros_messages import (
    RosMessage,
    camera_frame,
    camera_info_message,
    clock_message,
    image_message,
    jpeg_message,
    ros_camera,
    state_messages,
    transform_message,
)
from vrcaps.formats.shared.stored_images import jpeg_bytes
from vrcaps.motion.motion import Step
from vrcaps.motion.rollout import Rollout
from vrcaps.recording.sensing import SensorReadings
from vrcaps.recording.table import TableRows
from vrcaps.render.channels import CHANNELS
from vrcaps.render.renderer import Renderer
from vrcaps.scenario.build import build
from vrcaps.world.model import MovingWall

if TYPE_CHECKING:
    from vrcaps.recording.table import FrameTable
    from vrcaps.render.channels import Frame
    from vrcaps.scenario.scenario import Scenario

STEP, SET_STATE = "/step_simulation", "/set_simulation_state"
"""Services, in the form of the ROS package simulation_interfaces."""
_PLAYING, _PAUSED = 1, 2
_OK, _FAILED = 1, 4
"""Values of SimulationState and Result in simulation_interfaces."""
_MAX_STEPS = 10**6
_QUALITY = 90
"""JPEG quality of images."""
"""Field of view of a pinhole that replaces a lens of which ROS has no model."""


class FrameGate:
    """Pause of a simulation before a frame, and the responses that wait for one."""

    def __init__(self, *, is_paused: bool) -> None:
        """Start.

        Args:
            is_paused: Whether to wait for `step` before the first frame.
        """
        self._changed = threading.Condition()
        self._until = 0.0 if is_paused else math.inf
        self._next, self._waiting = 0, list[tuple[int, Respond]]()

    def published(self, index: int) -> None:
        """Respond to the steps that end before a frame."""
        with self._changed:
            self._next = index
            due = [respond for last, respond in self._waiting if last <= index]
            self._waiting = [entry for entry in self._waiting if entry[0] > index]
        for respond in due:
            respond(_result())

    def wait(self, index: int) -> bool:
        """Wait until a frame may be simulated; return whether there was a pause."""
        with self._changed:
            is_waiting = index >= self._until
            self._changed.wait_for(lambda: index < self._until)
        return is_waiting

    def end(self) -> None:
        """Respond to all other steps that the simulation has ended."""
        for _, respond in self._waiting:
            respond(_result("The simulation has ended."))

    def step(self, arguments: dict[str, Any], respond: Respond) -> None:
        """Service: simulate a number of frames while paused, and respond when they are published.

        Raises:
            InputError: If the simulation is not paused, or `steps` is invalid.
        """
        steps = arguments.get("steps", 1)
        is_valid = type(steps) is int and 1 <= steps <= _MAX_STEPS
        require(is_valid, "steps", repr(steps)[:80], f"1 to {_MAX_STEPS}")
        with self._changed:
            if self._until == math.inf:
                raise InputError(f"The simulation is running. Pause it first, by {SET_STATE}.")
            self._until = max(self._until, self._next) + steps
            self._waiting.append((int(self._until), respond))
            self._changed.notify_all()

    def set_state(self, arguments: dict[str, Any], respond: Respond) -> None:
        """Service: pause or resume.

        Raises:
            InputError: If the state is neither.
        """
        given = arguments.get("state")
        state = given.get("state") if isinstance(given, dict) else given
        allowed = f"{_PLAYING} (playing) or {_PAUSED} (paused)"
        require(state in (_PLAYING, _PAUSED), "state", repr(state)[:80], allowed)
        with self._changed:
            if state == _PLAYING:
                self._until = math.inf
            elif self._until == math.inf:
                self._until = self._next + 1
            self._changed.notify_all()
        respond(_result())


def _result(error: str = "") -> dict[str, Any]:
    """Answer of a service."""
    return {"result": {"result": _FAILED if error else _OK, "error_message": error}}


class LiveSimulation:
    """Simulation of a scenario whose magnet or coils are controlled by clients, frame by frame.

    Attributes:
        scenario: The scenario, without open settings.
        commands: Receiver of commands.
        gate: Pauses the simulation.
        kinds: Type of the published messages by topic.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        real_time_factor: float = 1.0,
        is_paused: bool = False,
        field_of_view: float | None = None,
    ) -> None:
        """Build the world.

        Args:
            scenario: Scenario to simulate, see `cockpit_scenario`.
            real_time_factor: Simulated time per real time; 0 is as fast as possible.
            is_paused: Whether to wait for the service `/step_simulation` before the first frame.
            field_of_view: Horizontal field of view of a pinhole to which images are resampled
                [rad]; None keeps lenses that ROS can describe, and is 90° for others.

        Raises:
            InputError: If the scenario is invalid, the capsule has no magnet, or a lens does not
                see the field of view.
        """
        is_valid = math.isfinite(real_time_factor) and real_time_factor >= 0.0
        require(is_valid, "real_time_factor", real_time_factor, "0 or more")
        require_drivable(scenario)
        # No standard message holds the readings of a Hall array.
        sensors = replace(scenario.sensors.with_inertial(), hall=None)
        scenario = replace(scenario, sensors=sensors)
        self._resolved = resolved = cockpit_scenario(scenario)
        self.scenario = resolved.scenario
        self._published = {
            camera.name: ros_camera(camera, field_of_view) for camera in resolved.unit.cameras
        }
        self.model, rollout = build(resolved)
        assert isinstance(rollout, Rollout)
        self.rollout = rollout
        self.commands = _commands_of(rollout)
        self.gate = FrameGate(is_paused=is_paused)
        self._clock = Clock(real_time_factor or math.inf)
        self._wall = MovingWall(self.model)
        known = [name for name in resolved.channels if name in LIVE_CHANNELS]
        self._channels = tuple(
            name for name in known if name == "rgb" or CHANNELS[name].encoding.components == 1
        )
        self._cameras = CapsuleCameras(
            Renderer(self.model, self.scenario.render, self._wall),
            resolved.effects,
            fps=resolved.fps,
            seed=self.scenario.seed,
            channels=self._channels,
        )
        self._readings = SensorReadings(self.model, resolved)
        self.kinds = self._kinds()

    def run(
        self,
        publish: Callable[[Iterator[RosMessage]], None],
        wanted: Callable[[], frozenset[str]],
        duration: float = math.inf,
    ) -> float:
        """Simulate and publish, until a simulated time [s]; return the last one [s].

        Args:
            publish: Called with the messages of each frame.
            wanted: Returns the topics to publish; images of others are not rendered.
            duration: Time of the last frame [s].

        Raises:
            InputError: If the world cannot be stepped.
        """
        previous = None
        for moment in self.rollout.moments(None, self._pace, lambda: False):
            step = Step(moment.index, moment.state, previous=previous, command=moment.command)
            if moment.index == 0:
                self.gate.wait(0)
                self._clock.run()
            publish(self._messages(step, wanted()))
            previous = moment.state
            self.gate.published(moment.index + 1)
            if previous.time >= duration - 1e-9:
                break
            if self.gate.wait(moment.index + 1):
                self._clock.run()  # lost time is not caught up
        self.gate.end()
        return 0.0 if previous is None else previous.time

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the setup, one line each."""
        resampled = [view.note for view in self._published.values() if view.is_resampled]
        return (*self.rollout.notes, *resampled)

    def _pace(self, simulated: float, duration: float) -> None:
        """Wait until the next step is due; called after each."""
        del simulated, duration
        time = self.rollout.world.time
        if time >= 0.0:
            self._clock.wait(time)

    def _messages(self, step: Step, wanted: frozenset[str]) -> Iterator[RosMessage]:
        """Messages of a frame; images only if they are wanted."""
        ns, table = time_ns(step.state.time), self._row(step)
        yield clock_message(ns)
        yield from state_messages(table, 0, step.state.time)
        for name, view in self._published.items():
            yield transform_message(ns, camera_frame(name), table.poses(name)[0])
            yield camera_info_message(ns, view.target, name)
        topics = {name: wanted & self._image_topics(name).keys() for name in self._published}
        if any(topics.values()):
            for name, frame in self._cameras.capture(step).items():
                yield from self._image_messages(ns, name, frame, topics[name])

    def _image_messages(
        self, ns: int, camera: str, frame: Frame, wanted: frozenset[str]
    ) -> Iterator[RosMessage]:
        view = self._published[camera]
        for channel in self._channels:
            topic = f"/{camera}/{channel}"
            if wanted.isdisjoint((topic, f"{topic}/compressed")):
                continue
            image = view.image(getattr(frame, channel), channel)
            if topic in wanted:
                yield image_message(ns, camera, channel, image)
            if f"{topic}/compressed" in wanted:
                yield jpeg_message(ns, camera, jpeg_bytes(image, _QUALITY))

    def _row(self, step: Step) -> FrameTable:
        """Row of the table of a recording."""
        rows = TableRows(self.model, wall=self._wall)
        measured = self._readings.read(step, self.rollout.sources(step))
        exposed = self._cameras.expose(step)
        rows.add(step, {**self.rollout.columns(step), **exposed, **measured})
        return rows.table()

    def _image_topics(self, camera: str) -> dict[str, str]:
        topics = {f"/{camera}/{name}": "sensor_msgs/msg/Image" for name in self._channels}
        if "rgb" in self._channels:
            topics[f"/{camera}/rgb/compressed"] = "sensor_msgs/msg/CompressedImage"
        return topics

    def _kinds(self) -> dict[str, str]:
        kinds = {
            "/clock": "rosgraph_msgs/msg/Clock",
            "/tf": "tf2_msgs/msg/TFMessage",
            "/capsule/pose": "geometry_msgs/msg/PoseStamped",
            "/capsule/imu": "sensor_msgs/msg/Imu",
            "/capsule/magnetometer": "sensor_msgs/msg/MagneticField",
            "/capsule/command": "geometry_msgs/msg/WrenchStamped",
        }
        program = self.rollout.program
        if program is None:
            kinds["/coils/joint_states"] = "sensor_msgs/msg/JointState"
        else:
            kinds["/magnet/pose"] = "geometry_msgs/msg/PoseStamped"
            if isinstance(program.controller.actuator, RobotActuator):
                kinds["/joint_states"] = "sensor_msgs/msg/JointState"
        for camera in self._published:
            kinds[f"/{camera}/camera_info"] = "sensor_msgs/msg/CameraInfo"
            kinds |= self._image_topics(camera)
        return kinds


def _commands_of(rollout: Rollout) -> Commands:
    if rollout.coils is not None:
        return CoilCommands(rollout.coils)
    program = rollout.program
    assert program is not None
    has_arm = isinstance(program.controller.actuator, RobotActuator)
    return ArmCommands(program) if has_arm else MagnetCommands(program)


@contextmanager
def open_bridge(
    simulation: LiveSimulation,
    *,
    host: str = "127.0.0.1",
    port: int = 9090,
    origins: Sequence[str] = (),
    on_message: Callable[[str], None] = lambda text: None,
) -> Iterator[BridgeServer]:
    """Serve the clients of a simulation within a `with` block.

    Example:
        >>> simulation = LiveSimulation(vrcaps.Scenario("stomach", "magnetic"))
        >>> with open_bridge(simulation) as server:
        ...     simulation.run(server.publish, lambda: server.wanted, duration=10.0)

    Args:
        simulation: The simulation.
        host: Address to listen at.
        port: Port to listen at.
        origins: Origins of web pages that may connect, such as ``http://localhost:3000``.
        on_message: Called with each line for the terminal.

    Raises:
        InputError: If the port is in use or the host is not of this machine.
        MissingExtraError: If websockets is not installed.
    """
    services = {STEP: simulation.gate.step, SET_STATE: simulation.gate.set_state}
    server = BridgeServer(simulation.kinds, simulation.commands, services, on_message)
    with serving(server, host, port, origins):
        yield server
