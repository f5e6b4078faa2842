"""Two-point centerline follower with band-limited noise, pushed off the wall, for fly-throughs.

Two points of the capsule, near its ends, lie on a curve: the centerline plus a lateral drift. Body
and cameras therefore follow bends. Drift, tilt, roll and speed vary with band-limited noise, a sum
of sines of the distance traveled.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.capsule.device import Device
from vrcaps.core.geometry import rotation_from_vector, transform_from
from vrcaps.core.units import MM
from vrcaps.organ.surface import Centerline, interpolate
from vrcaps.world.model import Model

if TYPE_CHECKING:
    from jaxtyping import Float

_NUM_WAVES = 4
_PROBE = 0.2 * MM
_PUSH = 0.3 * MM
_LEVER = 10.0 * MM  # distance equivalent to a rotation of 1 rad
_MAX_PUSHES = 80


@dataclass(frozen=True)
class BandLimitedNoise:
    """Smooth noise along the path: sums of sines, each with absolute values up to 1."""

    wave_numbers: Float[np.ndarray, "c k"]
    phases: Float[np.ndarray, "c k"]

    def at(
        self, distance: Float[np.ndarray, " n"], channels: slice = slice(None)
    ) -> Float[np.ndarray, "n c"]:
        """Values of some of the noises at distances along the path [m]."""
        angle = distance[:, None, None] * self.wave_numbers[channels] + self.phases[channels]
        return np.sin(angle).mean(axis=-1)

    def integral(self, distance: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n c"]:
        """Integrals of the noises from 0 to distances along the path [m]."""
        angle = distance[:, None, None] * self.wave_numbers + self.phases
        return ((np.cos(self.phases) - np.cos(angle)) / self.wave_numbers).mean(axis=-1)

    def swinging(self, channels: slice) -> BandLimitedNoise:
        """Noise with a single wave in some channels, which is thus often near its maximum."""
        wave_numbers, phases = self.wave_numbers.copy(), self.phases.copy()
        for waves in (wave_numbers, phases):
            waves[channels] = waves[channels, :1]
        return BandLimitedNoise(wave_numbers, phases)


def make_noise(smoothness: float, rng: np.random.Generator, *, count: int) -> BandLimitedNoise:
    """`count` independent noises with wavelengths from `smoothness` [m] to four times that."""
    wavelengths = smoothness * 4.0 ** rng.uniform(size=(count, _NUM_WAVES))
    return BandLimitedNoise(
        2.0 * np.pi / wavelengths, rng.uniform(0.0, 2.0 * np.pi, (count, _NUM_WAVES))
    )


@dataclass(frozen=True)
class CenterlineFollower:
    """Poses of the capsule by the arc length of its center on the centerline [m].

    Attributes:
        centerline: Centerline in the world frame.
        noise: Noise of two drifts, two tilts and the roll.
        front: Distance of the front point ahead of the capsule's origin [m].
        rear: Distance of the rear point behind it [m].
        sign: 1 to travel towards the anal end, −1 towards the oral end.
        drift: Maximum drift as a fraction of the radius.
        tilt: Maximum angle from the direction of travel [rad].
        roll: Maximum angle about the capsule's axis [rad].
        amplitude: Fraction of the drift and tilt retained, by arc length.
        correction: Shift [m] and rotation [rad] of the capsule in its own frame, by arc length.
    """

    centerline: Centerline
    noise: BandLimitedNoise
    front: float
    rear: float
    sign: float
    drift: float
    tilt: float
    roll: float
    amplitude: Callable[[np.ndarray], np.ndarray]
    correction: Callable[[np.ndarray], np.ndarray] | None = None

    def poses(self, s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 4 4"]:
        """Poses with the capsule's center near arc lengths `s` [m]."""
        amplitude, noise = self.amplitude(s), self.noise.at(s)
        rear, front = self._two_points(s, amplitude)
        forward = front - rear
        forward /= np.linalg.norm(forward, axis=1, keepdims=True)
        _, frame, _ = interpolate(self.centerline, s)
        if self.sign < 0.0:  # rotated about its first axis, so that z points along the travel
            frame = frame * np.array([1.0, -1.0, -1.0])
        rotation = _turn(frame[:, :, 2], forward) @ frame
        tilt, spin = np.zeros((len(s), 3)), np.zeros((len(s), 3))
        tilt[:, :2] = (amplitude * self.tilt)[:, None] * noise[:, 2:4] / np.sqrt(2.0)
        spin[:, 2] = self.roll * noise[:, 4]
        rotation = rotation @ rotation_from_vector(tilt) @ rotation_from_vector(spin)
        poses = transform_from(rotation, rear + self.rear * forward)
        return poses if self.correction is None else corrected(poses, self.correction(s))

    def _two_points(self, s: np.ndarray, amplitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rear and front points on the path, a fixed distance apart."""
        wheelbase = self.front + self.rear
        stretch = np.ones_like(s)
        rear, front = self._ends(s, amplitude, stretch)
        for _ in range(8):
            chord = np.linalg.norm(front - rear, axis=1)
            stretch = np.clip(stretch * wheelbase / np.maximum(chord, 1e-9), 1.0, 3.0)
            rear, front = self._ends(s, amplitude, stretch)
        return rear, front

    def _ends(
        self, s: np.ndarray, amplitude: np.ndarray, stretch: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        return (
            self._point(s - self.sign * stretch * self.rear, amplitude),
            self._point(s + self.sign * stretch * self.front, amplitude),
        )

    def _point(self, s: np.ndarray, amplitude: np.ndarray) -> np.ndarray:
        point, frame, radius = interpolate(self.centerline, s)
        offset = np.empty((len(s), 3))
        offset[:, :2] = (amplitude * self.drift * radius)[:, None] * self.noise.at(s, slice(2))
        offset[:, :2] /= np.sqrt(2.0)
        # Beyond the ends of the centerline the path continues straight.
        offset[:, 2] = s - np.clip(s, 0.0, self.centerline.length)
        return point + (frame @ offset[:, :, None])[:, :, 0]


def corrected(
    poses: Float[np.ndarray, "n 4 4"], correction: Float[np.ndarray, "n 6"]
) -> Float[np.ndarray, "n 4 4"]:
    """Shift [m] and rotate [rad] poses in their own frames."""
    return poses @ transform_from(rotation_from_vector(correction[:, 3:]), correction[:, :3])


def push_inside(
    model: Model, poses: Float[np.ndarray, "n 4 4"], *, need: float, blur: float
) -> Float[np.ndarray, "n 6"]:
    """Smooth corrections of neighboring poses that move origin and cameras into the lumen.

    Alternates between moving poses too close to the wall along the gradient of their clearance, and
    blurring all corrections along the path. May fail where the lumen is too narrow.

    Args:
        model: The lumen and the capsule.
        poses: Poses along a path, close to each other.
        need: Clearance to reach [m].
        blur: Standard deviation of the blur [poses].

    Returns:
        Shift [m] and rotation [rad] of each pose, for `corrected`.
    """
    from scipy.ndimage import binary_dilation, gaussian_filter1d  # slow to load

    correction = np.zeros((len(poses), 6))
    unit = np.array([1.0] * 3 + [1.0 / _LEVER] * 3)
    blocked = model.vital_clearance(poses) < need
    if not blocked.any():
        return correction
    # A push affects its neighbors only through the blur, so the window is limited to its reach.
    window = np.flatnonzero(binary_dilation(blocked, iterations=int(10.0 * blur)))
    for _ in range(_MAX_PUSHES):
        clearance = model.vital_clearance(corrected(poses[window], correction[window]))
        near, clearance = window[clearance < need], clearance[clearance < need]
        if len(near) == 0:
            break
        gradient = np.empty((len(near), 6))
        for axis in range(6):
            probe = correction[near]
            probe[:, axis] += _PROBE * unit[axis]
            moved = model.vital_clearance(corrected(poses[near], probe))
            gradient[:, axis] = moved - clearance
        gradient /= np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-12)
        correction[near] += _PUSH * gradient * unit
        correction = gaussian_filter1d(correction, blur, axis=0, mode="constant")
    return correction


def follower_offsets(device: Device) -> tuple[float, float]:
    """Distances of the front and rear points from the capsule's origin [m].

    They are at the outermost cameras, but at least as far out as the ends of the body's axis.
    """
    heights = [float(camera.position[2]) for camera in device.cameras]
    axis = device.length / 2.0 - device.radius
    return max(axis, *heights), max(axis, *(-height for height in heights))


def _turn(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """Minimal rotations from directions a to directions b."""
    a = a / np.linalg.norm(a, axis=1, keepdims=True)
    axis = np.cross(a, b)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(sine, (a * b).sum(axis=1, keepdims=True))
    return rotation_from_vector(axis * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 1.0))
