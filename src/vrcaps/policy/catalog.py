"""Policies by name: baselines, trained policies of the package, import paths and files."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.registry import Registry
from vrcaps.policy.policy import Policy

BASELINES: Registry[Policy] = Registry(
    "policy",
    {
        "random": ("vrcaps.policy.baselines:RandomPolicy", "random targets or actions"),
        "centerline": ("vrcaps.policy.baselines:CenterlinePolicy", "along the centerline"),
        "look-around": ("vrcaps.policy.baselines:LookAroundPolicy", "with views on a cone"),
        "next-best-view": (
            "vrcaps.policy.next_best_view:NextBestViewPolicy",
            "to the view with the most unseen wall per time",
        ),
        "explorer": (
            "vrcaps.policy.explorer:ExplorerPolicy",
            "by a magnet or arm to unknown space of its map",
        ),
        "navigator": ("vrcaps.policy.navigator:NavigatorPolicy", "by a magnet to a goal"),
    },
)
"""Policies without training by name; they are created without arguments."""

_NO_POLICY = (
    "is not a policy. Allowed: a class with `requires`, `reset` and `act`, see "
    "vrcaps.policy.policy.Policy."
)

_SHIPPED = Path(__file__).parent / "trained"
"""Folder of the trained policies that come with the package."""


def read_policy(name: str | Path) -> Policy:
    """Create a policy by the name of a baseline, an import path, or the file of a trained policy.

    Example:
        >>> read_policy("centerline")
        >>> read_policy("my_package.my_module:MyPolicy")
        >>> read_policy("runs/coverage/best.npz")

    Raises:
        UnknownNameError: If no baseline or file has that name.
        InputError: If the class cannot be imported, or the file holds no policy.
    """
    text = str(name)
    if text in BASELINES:
        return BASELINES[text]()
    shipped = _shipped()
    path = shipped.get(text, Path(name))
    if path.is_file():
        from vrcaps.policy.mlp_policy import read_mlp_policy

        return read_mlp_policy(path)
    if ":" in text:
        return _imported(text)
    known = [*BASELINES, *shipped, "an import path package.module:Class", "a trained policy's file"]
    raise UnknownNameError("policy", text, known)


def policy_names(actuation: str) -> tuple[str, ...]:
    """Names of the baselines and of the trained policies of the package that fit an actuation.

    Args:
        actuation: Its kind, such as `magnet`.
    """
    kinds = {name: read_policy(name).requires.actuations for name in (*BASELINES, *_shipped())}
    return tuple(name for name, known in kinds.items() if not known or actuation in known)


def _shipped() -> dict[str, Path]:
    """Files of the trained policies that come with the package, by name."""
    return {path.stem: path for path in sorted(_SHIPPED.glob("*.npz"))}


def _imported(path: str) -> Policy:
    """Create a policy from the import path of its class, without arguments.

    Raises:
        InputError: If the module cannot be imported, or the path is not that of a policy class.
    """
    module_name, _, class_name = path.partition(":")
    try:
        module = importlib.import_module(module_name)
        cls = getattr(module, class_name, None)  # a module may import on access
    except (Exception, SystemExit) as error:  # a module may raise anything
        raise InputError(
            f"No policy at {path}: {_reason(error)}. Give package.module:Class, importable from "
            "here."
        ) from error
    if cls is None:
        raise InputError(f"No policy at {path}: the module has no {class_name!r}.")
    # Checked before the call: a path may name any function, such as os:abort.
    if not _is_policy_class(cls):
        raise InputError(f"{path} {_NO_POLICY}")
    try:
        policy = cls()
    except (Exception, SystemExit) as error:
        raise InputError(f"{path} cannot be made without arguments: {_reason(error)}.") from error
    if not isinstance(policy, Policy):
        raise InputError(f"{path} {_NO_POLICY}")
    return policy


def _is_policy_class(value: Any) -> bool:
    """Return whether a value is a class with `Policy`'s methods; instances may set `requires`."""
    if not isinstance(value, type):
        return False
    return all(callable(getattr(value, name, None)) for name in ("reset", "act"))


def _reason(error: BaseException) -> str:
    """Type and first line of an error."""
    first = next(iter(str(error).splitlines()), "").rstrip(".")
    return f"{type(error).__name__}: {first}" if first else type(error).__name__
