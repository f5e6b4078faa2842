"""Flags of `vrcaps record --motion dynamics`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import UseAppendAction

from vrcaps.errors import InputError
from vrcaps.motion.dynamics import Dynamics
from vrcaps.motion.fly_through import FlyThrough
from vrcaps.tissue.drag import Drag
from vrcaps.tissue.motility.propulsion import Propulsion
from vrcaps.world.schedule import Insufflation, PostureChange, Wrench

_ZERO = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class DynamicsFlags:
    """Flags beside `--motion dynamics`; time 0 is the first frame."""

    angle: float = Dynamics.angle
    """Between the capsule's front and the way towards the anal end [rad]: 3.14 looks back."""

    deformation: Literal["spring", "fem", "rigid"] = Dynamics.deformation
    """How the wall gives way: quick near the contact, fem as an elastic layer, or rigid."""

    drag: Literal["physical", "incetan2021", "continuous"] = "physical"
    """How it resists sliding: friction and stretching of the wall (physical), or the published
    fit of force against speed, with its jump (incetan2021) or without (continuous)."""

    friction: float = Drag.friction
    """Coefficient of friction of --drag physical; measured: 0.0004 to 0.018."""

    motility: Literal["none", "fasting", "phase-three", "steady"] = Dynamics.motility
    """What the muscle does: nothing; the fasting gut's cycle of one to four hours, by chance; the
    strongest phase of that cycle, around the capsule; or every segment contracting evenly."""

    fallback_segment: str | None = None
    """Segment, such as jejunum or sigmoid, whose muscle the wall has where vrcaps does not know
    its own name, as in a mesh file."""

    propulsion: bool = False
    """Let the muscle also pull at the capsule with the published law beta (v - u)."""

    force: tuple[float, float, float] = _ZERO
    """Constant force on the capsule from the first frame on [N]."""

    torque: tuple[float, float, float] = _ZERO
    """Constant torque on the capsule from the first frame on [N m]."""

    wrench: Path | None = None
    """Force and torque in time instead: a CSV with the header
    time_s,fx_n,fy_n,fz_n,tx_nm,ty_nm,tz_nm; linear between its rows."""

    wrench_frame: Literal["world", "capsule", "gut"] = Dynamics.wrench_frame
    """Axes of force and torque: the world's (z up), the capsule's (z ahead) or the gut's (z along
    it, towards the anal end)."""

    posture_change: Annotated[tuple[str, ...], UseAppendAction] = ()
    """Turn the patient, such as left-lateral:time=4,duration=6 (seconds); may be repeated."""

    insufflation: str = "1"
    """Factor on the lumen's width: 1.2, or at several times, such as 0:1,10:1.3 (seconds)."""

    settle: float = Dynamics.settle
    """Time that passes before the first frame, without commands [s]."""

    step: float = Dynamics.step
    """Longest time between updates of muscle and commands [s]."""

    substep: float = Dynamics.substep
    """Longest substep of the dynamics [s]; 2e-4 is four times faster and does for gentle
    forces."""

    def motion(self, start: float) -> Dynamics:
        """The motion that the flags ask for, from a share of the centreline on.

        Raises:
            InputError: If a flag is impossible or contradicts another.
            UnknownNameError: If there is no such posture.
        """
        if self.wrench is not None and (self.force, self.torque) != (_ZERO, _ZERO):
            raise InputError("--wrench states force and torque. Drop --force and --torque, or it.")
        if self.drag != "physical" and self.friction != Drag.friction:
            raise InputError(f"--friction goes with --drag physical, not with {self.drag}.")
        is_pushed = (self.force, self.torque) != (_ZERO, _ZERO)
        return Dynamics(
            start=start,
            angle=self.angle,
            deformation=self.deformation,
            drag=Drag(law=self.drag, friction=self.friction),
            motility=self.motility,
            fallback_segment=self.fallback_segment,
            propulsion=Propulsion() if self.propulsion else None,
            wrenches=(Wrench(0.0, self.force, self.torque),) if is_pushed else (),
            wrench_file=None if self.wrench is None else str(self.wrench),
            wrench_frame=self.wrench_frame,
            posture_changes=tuple(parse_posture_change(text) for text in self.posture_change),
            insufflation=parse_insufflation(self.insufflation),
            settle=self.settle,
            step=self.step,
            substep=self.substep,
        )


def dynamics_motion(fly: FlyThrough, flags: DynamicsFlags, *, motion: str = "dynamics") -> Dynamics:
    """The motion of `--motion dynamics`, or of another that moves the capsule by dynamics.

    Raises:
        InputError: If flags of a fly-through are given beside it, or as `DynamicsFlags.motion`.
    """
    if replace(fly, start=FlyThrough.start) != FlyThrough():
        raise InputError(
            f"--motion {motion} lets the capsule move by itself, so --end, --speed, --drift and "
            "the other flags of the fly-through have no meaning beside it. Allowed: --start."
        )
    return flags.motion(fly.start)


def parse_posture_change(text: str) -> PostureChange:
    """A change of posture such as ``left-lateral:time=4,duration=6``.

    Raises:
        InputError: If it is written in another way.
    """
    posture, _, rest = text.partition(":")
    change = PostureChange(posture)
    for part in filter(None, rest.split(",")):
        key, _, value = part.partition("=")
        if key not in ("time", "duration"):
            raise InputError(
                f"--posture-change {text}: no {key!r}. "
                "Allowed: POSTURE:time=SECONDS,duration=SECONDS."
            )
        change = replace(change, **{key: _number(value, f"--posture-change {text}: {key}")})
    return change


def parse_insufflation(text: str) -> tuple[Insufflation, ...]:
    """A factor such as ``1.2``, or pairs of time and factor such as ``0:1,10:1.3``.

    Raises:
        InputError: If it is written in another way.
    """
    flag = f"--insufflation {text}"
    if ":" not in text:
        factor = _number(text, flag)
        return () if factor == 1.0 else (Insufflation(0.0, factor),)
    insufflation = []
    for part in text.split(","):
        time, _, factor = part.partition(":")
        insufflation.append(Insufflation(_number(time, flag), _number(factor, flag)))
    return tuple(insufflation)


def _number(text: str, where: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise InputError(f"{where} is {text!r}. Allowed: a number.") from error
