"""Warm starts: initialization of a training from another one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from vrcaps.core.errors import InputError
from vrcaps.core.files import read_arrays
from vrcaps.policy.mlp_policy import read_mlp_policy
from vrcaps.policy.ppo import Ppo

CHECKPOINT = "checkpoint.npz"


def start_file(start: Path) -> Path:
    """Resolve a start to a file: the checkpoint of a training's folder, or a policy's file.

    Raises:
        InputError: If there is none.
    """
    path = start / CHECKPOINT if start.is_dir() else start
    if not path.is_file():
        raise InputError(
            f"{start} holds no {CHECKPOINT}. Give the folder of a training, or a policy's file."
        )
    return path


def warm_start(learner: Ppo, path: Path) -> None:
    """Initialize a learner from a checkpoint or a policy's file.

    A checkpoint holds the policy, its value function, Adam's moments and the normalizer; the file
    of a policy holds the policy and the normalizer.

    Args:
        learner: Untrained learner.
        path: File from `start_file`.

    Raises:
        InputError: If the file is damaged, or of other observations, actions or layers.
    """
    try:
        if path.name == CHECKPOINT:
            arrays = read_arrays(path)
            arrays.pop("progress")
            learner.load(arrays)
        else:
            _load_policy(learner, path)
    except (OSError, ValueError, LookupError, RuntimeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"Cannot start from {path}: {str(error).splitlines()[0]} Allowed: a training of the "
            "same observations, actions and layers."
        ) from error


def _load_policy(learner: Ppo, path: Path) -> None:
    import torch

    policy, net = read_mlp_policy(path), learner.model.policy
    chain: list[Any] = [*net.mlp_extractor.policy_net, net.action_net]  # type: ignore[attr-defined]
    layers = [module for module in chain if hasattr(module, "weight")]
    given = [weight.shape for weight, _ in policy.layers]
    own = [tuple(module.weight.shape) for module in layers]
    if given != own:
        raise InputError(f"{path} has layers of {given}. Allowed: {own}, as the settings have.")
    with torch.no_grad():
        for module, (weight, bias) in zip(layers, policy.layers, strict=True):
            module.weight.copy_(torch.from_numpy(weight))
            module.bias.copy_(torch.from_numpy(bias))
    if learner.settings.is_normalized:
        spread: Any = learner.envs.obs_rms
        spread.mean, spread.var = policy.normalizer.mean.copy(), policy.normalizer.variance.copy()
        spread.count = float(learner.actions_per_round)  # as if one round had been seen
