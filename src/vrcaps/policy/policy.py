"""Protocol of a policy, which chooses the actions in an environment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from vrcaps.core.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from vrcaps.env.settings import EnvSettings
    from vrcaps.env.vector_env import CapsuleVectorEnv


@dataclass(frozen=True)
class Requirements:
    """Requirements of a policy on its environment; empty fields require nothing.

    Attributes:
        settings: Keyword arguments of `env_settings` that it is designed for, such as
            `observations`; an evaluation uses them as defaults.
        observations: Names of the observations that it reads.
        actuations: Kinds of actuation that it supports; one is needed.
    """

    settings: dict[str, Any] = field(default_factory=dict)
    observations: tuple[str, ...] = ()
    actuations: tuple[str, ...] = ()

    def check(self, settings: EnvSettings, name: str) -> None:
        """Check that an environment meets the requirements.

        Args:
            settings: Settings of the environment.
            name: Name of the policy.

        Raises:
            InputError: If something is missing.
        """
        given = [observation.name for observation in settings.observations]
        missing = [n for n in self.observations if n not in given]
        if missing:
            raise InputError(
                f"{name} reads the observations {', '.join(self.observations)}; the environment "
                f"gives {', '.join(given)}. Add {', '.join(missing)}."
            )
        kind = settings.actuation.kind
        if self.actuations and kind not in self.actuations:
            raise InputError(
                f"{name} acts by {' or '.join(self.actuations)}; the environment's actuation is "
                f"{kind}. Choose another actuation or policy."
            )


@runtime_checkable
class Policy(Protocol):
    """Policy that chooses an action for each world of a vector environment.

    It may use observations only, or `env.view`, which is not available to a real capsule. Its
    randomness depends on the seeds of its episodes alone, so that an episode does not depend on the
    other worlds.
    """

    @property
    def requires(self) -> Requirements:
        """Requirements on the environment."""
        ...

    def reset(self, indices: np.ndarray, seeds: Sequence[int]) -> None:
        """Reset the state of some worlds in which an episode starts.

        Args:
            indices: Indices of the worlds.
            seeds: Seeds of their episodes, one for each.
        """
        ...

    def act(self, observations: dict[str, np.ndarray], env: CapsuleVectorEnv) -> np.ndarray:
        """Return actions for all worlds, a row each.

        Args:
            observations: Arrays by name, with a row for each world.
            env: The environment; read-only.
        """
        ...
