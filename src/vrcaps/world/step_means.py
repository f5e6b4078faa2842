"""Contact and magnetic coupling averaged over several equal steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vrcaps.world.model import Contact, Coupling


def mean_contact(contacts: Sequence[Contact]) -> Contact:
    """Mean force and torque, total work, and the contact patch of the last step."""
    return replace(
        contacts[-1],
        force_world=np.mean([contact.force_world for contact in contacts], axis=0),
        torque_world=np.mean([contact.torque_world for contact in contacts], axis=0),
        normal_force_total=float(np.mean([contact.normal_force_total for contact in contacts])),
        friction_work=float(np.sum([contact.friction_work for contact in contacts])),
    )


def mean_coupling(couplings: Sequence[Coupling | None]) -> Coupling | None:
    """Mean force and torque, the rest from the last step; None if the last step has none."""
    last, known = couplings[-1], [coupling for coupling in couplings if coupling is not None]
    if last is None:
        return None
    return replace(
        last,
        force_world=np.mean([coupling.force_world for coupling in known], axis=0),
        torque_world=np.mean([coupling.torque_world for coupling in known], axis=0),
        is_exact=all(coupling.is_exact for coupling in known),
    )
