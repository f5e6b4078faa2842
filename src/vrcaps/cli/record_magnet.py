"""Flags of `vrcaps record --motion magnet`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from vrcaps.actuation.steering_program import GENTLE_GAINS, MagnetSteering
from vrcaps.units import MM


@dataclass(frozen=True)
class MagnetFlags:
    """Flags beside `--motion magnet`."""

    magnet: str = MagnetSteering.magnet
    """The external magnet: cylinder-101.6 (6.2 kg), cylinder-76.2 (2.6 kg, the Panda may carry 3)
    or cylinder-50.8 (0.8 kg)."""

    arm: str | None = None
    """Robot arm that carries it: panda, or an arm file (TOML); by default the magnet moves without
    an arm."""

    arm_base: tuple[float, float, float] | None = None
    """Position of the arm's base in the world [m]; by default 55 cm beside the organ's center."""

    standoff_mm: float = MagnetSteering.standoff / MM
    """Least gap between the organ's highest point and the magnet [mm]."""

    wall_side: Literal["upper", "lower"] = MagnetSteering.wall
    """Wall along which the capsule slides: the lower, on which the magnet supports part of its
    weight, or the upper, to which the magnet pulls it."""

    wall_force: float | None = None
    """Force between capsule and wall [N]; by default 0.05 on the lower, 0.15 on the upper."""

    steering_speed_mm_per_s: float = MagnetSteering.speed / MM
    """Speed along the wall where no --commands are given [mm/s]; the target waits for the
    capsule."""

    steering_end: float = MagnetSteering.end
    """Where that ends, as a fraction of the centerline; before --start it leads back."""

    commands: Path | None = None
    """Positions at times, a CSV with the header time_s,arc_length_m,yaw_deg,pitch_deg; or joystick
    axes of -1 to 1, time_s,linear_x,linear_y,linear_z,angular_x,angular_y,angular_z."""

    def steering(self) -> MagnetSteering:
        """The settings that the flags ask for.

        Raises:
            InputError: If a flag is impossible.
        """
        gains = GENTLE_GAINS
        if self.wall_force is not None:
            force = self.wall_force
            gains = replace(gains, upper_wall_force=force, lower_wall_force=force)
        return MagnetSteering(
            magnet=self.magnet,
            arm=self.arm,
            arm_base=self.arm_base,
            standoff=self.standoff_mm * MM,
            wall=self.wall_side,
            speed=self.steering_speed_mm_per_s * MM,
            end=self.steering_end,
            gains=gains,
            command_file=None if self.commands is None else str(self.commands),
        )
