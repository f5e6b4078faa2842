"""Multilayer perceptron policy: inference with NumPy alone, and its file format."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

import numpy as np

from vrcaps import __version__
from vrcaps.config.convert import from_plain, to_plain
from vrcaps.config.plain_files import decode_json
from vrcaps.core.errors import InputError, VrcapsError
from vrcaps.core.files import read_arrays, write_arrays
from vrcaps.env.settings import EnvSettings
from vrcaps.policy.policy import Requirements

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.env.vector_env import CapsuleVectorEnv

_FORMAT = 1
_MAX_BYTES = 2**28
"""Maximum size of the arrays of a policy's file."""
_KEPT = (
    *("task", "actuation", "observations", "capsule", "control_period", "episode_time"),
    *("criteria", "grid", "num_points"),
)
"""Environment settings that a policy was trained for; its patients are excluded."""


@dataclass(frozen=True)
class Normalizer:
    """Mean and variance of observations; the policy's input is (x − mean) / √(variance + 1e-8).

    Attributes:
        mean: Mean of each value.
        variance: Variance of each value.
        limit: Normalized values are clipped to ± this.
    """

    mean: Float[np.ndarray, " k"]
    variance: Float[np.ndarray, " k"]
    limit: float = 10.0

    def __call__(self, rows: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
        """Normalize rows as Stable-Baselines3's `VecNormalize` does."""
        scaled = (rows - self.mean) / np.sqrt(self.variance + 1e-8)
        return np.clip(scaled, -self.limit, self.limit).astype(np.float32)


class MlpPolicy:
    """Layers with tanh activations, from normalized observations to the mean of the actions.

    In a discrete action space it chooses the action with the largest output.
    """

    def __init__(
        self,
        layers: Sequence[tuple[Float[np.ndarray, "o i"], Float[np.ndarray, " o"]]],
        normalizer: Normalizer,
        settings: dict[str, Any],
    ) -> None:
        """Initialize the policy.

        Args:
            layers: Weights and bias of each layer.
            normalizer: Normalizer of the observations, concatenated in the order of the settings.
            settings: Keyword arguments of `env_settings` that it was trained with.
        """
        self.layers = [(np.asarray(w, np.float32), np.asarray(b, np.float32)) for w, b in layers]
        self.normalizer, self.settings = normalizer, settings
        self._names = tuple(o.name for o in settings["observations"])

    @property
    def requires(self) -> Requirements:
        """Observations and actuation that it was trained with."""
        return Requirements(self.settings, self._names, (self.settings["actuation"].kind,))

    def reset(self, indices: np.ndarray, seeds: Sequence[int]) -> None:
        """Do nothing; the policy has no state."""

    def act(self, observations: dict[str, np.ndarray], env: CapsuleVectorEnv) -> np.ndarray:
        """Return actions for all worlds.

        Raises:
            InputError: If the observations or actions are not those that it was trained with.
        """
        space = env.single_action_space
        output = self.output(observations)
        count = getattr(space, "n", None)
        size = output.shape[1]
        if (count or int(np.prod(space.shape or ()))) != size:
            raise InputError(
                f"The policy outputs {size} numbers per action; the environment takes {space}. "
                "Use the actuation that it was trained with."
            )
        if count is not None:
            return output.argmax(axis=1)
        return np.clip(output.reshape(-1, *(space.shape or ())), space.low, space.high)  # type: ignore[attr-defined]

    def output(self, observations: dict[str, np.ndarray]) -> Float[np.ndarray, "n o"]:
        """Output of the last layer.

        Rows are multiplied one by one, so that an action does not depend on other worlds.
        """
        rows = [np.reshape(observations[n], (len(observations[n]), -1)) for n in self._names]
        given, known = sum(row.shape[1] for row in rows), len(self.normalizer.mean)
        if given != known:
            raise InputError(
                f"The observations {', '.join(self._names)} have {given} numbers; the policy was "
                f"trained with {known}. Use the settings that it was trained with."
            )
        values = self.normalizer(np.concatenate(rows, axis=1))[:, None, :]
        for index, (weight, bias) in enumerate(self.layers):
            values = (np.tanh(values) if index else values) @ weight.T + bias
        return values[:, 0]


def kept_settings(settings: EnvSettings) -> dict[str, Any]:
    """Environment settings that a policy's file stores."""
    return {name: getattr(settings, name) for name in _KEPT}


def write_mlp_policy(path: Path, policy: MlpPolicy, notes: dict[str, Any]) -> None:
    """Write a policy atomically; the same policy gives the same bytes.

    Args:
        path: An .npz file.
        policy: Trained policy.
        notes: Further metadata, plain values.
    """
    hints = get_type_hints(EnvSettings)
    plain = {name: to_plain(value, hints[name]) for name, value in policy.settings.items()}
    header = {"format": _FORMAT, "vrcaps": __version__, "settings": plain, "notes": notes}
    arrays = {"header": np.array(json.dumps(header, sort_keys=True))}
    for index, (weight, bias) in enumerate(policy.layers):
        arrays |= {f"layer_{index}/weight": weight, f"layer_{index}/bias": bias}
    normalizer = {k: np.asarray(v) for k, v in asdict(policy.normalizer).items()}
    write_arrays(path, arrays | {f"normalizer/{k}": v for k, v in normalizer.items()})


def read_mlp_policy(path: Path) -> MlpPolicy:
    """Read a policy that `write_mlp_policy` wrote.

    Raises:
        InputError: If the file contains no policy, one of another version of vrcaps, layers that do
            not fit each other or the observations, or values that are not finite.
    """
    try:
        arrays = read_arrays(path, _MAX_BYTES)
        header = decode_json(str(arrays["header"]), path)
        written, plain = header["vrcaps"], dict(header["settings"])
        count = sum(name.endswith("/weight") for name in arrays)
        layers = [(arrays[f"layer_{k}/weight"], arrays[f"layer_{k}/bias"]) for k in range(count)]
        values = {f.name: arrays[f"normalizer/{f.name}"] for f in fields(Normalizer)}
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise InputError(
            f"{path} contains no policy. Give a file that vrcaps train wrote."
        ) from error
    try:
        settings = _settings_of(header["format"], plain)
    except (VrcapsError, LookupError) as error:
        raise InputError(
            f"{path} is a policy of vrcaps {written}, which version {__version__} cannot run: "
            f"{error}"
        ) from error
    _require_numbers(path, [*values.values(), *(part for layer in layers for part in layer)])
    _require_shapes(path, layers, values)
    normalizer = Normalizer(values["mean"], values["variance"], float(values["limit"].ravel()[0]))
    return MlpPolicy(layers, normalizer, settings)


def _settings_of(form: Any, plain: dict[str, Any]) -> dict[str, Any]:
    """Parse the settings of a policy's file.

    Raises:
        InputError: If the format differs, or a setting is missing, unknown or not allowed.
    """
    if form != _FORMAT:
        raise InputError(f"its format is {form}, not {_FORMAT}")
    if set(plain) != set(_KEPT):
        differ = ", ".join(sorted(set(plain) ^ set(_KEPT)))
        raise InputError(f"its settings are not those of a policy: {differ}")
    hints = get_type_hints(EnvSettings)
    settings = {name: from_plain(hints[name], value, at=name) for name, value in plain.items()}
    EnvSettings(**settings)
    return settings


def _require_numbers(path: Path, arrays: list[np.ndarray]) -> None:
    """Check that arrays hold finite real numbers.

    Raises:
        InputError: If one does not.
    """
    for array in arrays:
        if array.dtype.kind not in "fiu" or not np.isfinite(array).all():
            raise InputError(f"{path} contains weights that are not finite real numbers.")


def _require_shapes(
    path: Path, layers: list[tuple[np.ndarray, np.ndarray]], values: dict[str, np.ndarray]
) -> None:
    """Check that the shapes of consecutive layers match, starting with the observations.

    Raises:
        InputError: If they do not, or the normalizer is impossible.
    """
    mean, variance, limit = values["mean"], values["variance"], values["limit"]
    fits = mean.ndim == 1 and variance.shape == mean.shape and limit.size == 1 and len(layers) > 0
    width = mean.shape[:1]
    for weight, bias in layers:
        fits = fits and weight.ndim == 2 and weight.shape[1:] == width
        fits = fits and bias.shape == weight.shape[:1]
        width = weight.shape[:1]
    if not fits or variance.min(initial=0.0) < 0.0 or float(limit.ravel()[0]) <= 0.0:
        raise InputError(
            f"{path} contains a policy whose layers or normalizer do not fit each other."
        )
