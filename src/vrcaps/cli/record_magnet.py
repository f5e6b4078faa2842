"""Flags of `vrcaps record --motion magnet`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from vrcaps.actuation.steering_program import GENTLE, MagnetSteering
from vrcaps.units import MM


@dataclass(frozen=True)
class MagnetFlags:
    """Flags beside `--motion magnet`."""

    magnet: str = MagnetSteering.magnet
    """The magnet outside: cylinder-101.6 (6.2 kg), cylinder-76.2 (2.6 kg, the Panda may carry 3) or
    cylinder-50.8 (0.8 kg)."""

    arm: str | None = None
    """Arm that carries it: panda, or an arm file (TOML); by default a hand without limits of
    reach."""

    arm_base: tuple[float, float, float] | None = None
    """Place of the arm's base in the world [m]; by default 55 cm beside the organ's middle."""

    skin_mm: float = MagnetSteering.skin / MM
    """Least gap between the organ's highest point and the magnet [mm]."""

    side: Literal["up", "down"] = MagnetSteering.side
    """Wall that the capsule glides along: the lower, lightened, or the upper, pulled against it."""

    press: float | None = None
    """Force between capsule and that wall [N]; by default 0.05 on the lower, 0.15 on the upper."""

    along_mm_per_s: float = MagnetSteering.speed / MM
    """Speed along the wall where no --steer is given [mm/s]; it waits for the capsule."""

    until: float = MagnetSteering.until
    """Where that ends, as a share of the centreline; before --start it leads back."""

    steer: Path | None = None
    """Where to be when, a CSV with the header time_s,arc_length_m,yaw_deg,pitch_deg; or a joystick
    of the magnet, time_s,move_x,move_y,move_z,turn_x,turn_y,turn_z with axes of -1 to 1."""

    def steering(self) -> MagnetSteering:
        """What the flags ask for.

        Raises:
            InputError: If a flag is impossible.
        """
        gains = GENTLE
        if self.press is not None:
            gains = replace(gains, press=self.press, rest=self.press)
        return MagnetSteering(
            magnet=self.magnet,
            arm=self.arm,
            base=self.arm_base,
            skin=self.skin_mm * MM,
            side=self.side,
            speed=self.along_mm_per_s * MM,
            until=self.until,
            steering=gains,
            file="" if self.steer is None else str(self.steer),
        )
