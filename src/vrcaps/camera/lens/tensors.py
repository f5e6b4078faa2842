"""Lenses on PyTorch tensors: the same formulas, with gradients by autograd.

Methods of a lens that are decorated with `on_tensors` take tensors beside arrays. They compute with
what `namespace` gives: NumPy, or this module, whose functions are PyTorch's. An inverse that has no
closed form is found by NumPy, and one more step of Newton's method in PyTorch gives its gradient.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

import numpy as np

Method = TypeVar("Method", bound=Callable[..., Any])

_TINY = float(np.finfo(float).tiny)


def __getattr__(name: str) -> Any:
    """A function of PyTorch, which takes what NumPy's takes."""
    if name.startswith("_"):  # the import system asks for such names
        raise AttributeError(name)
    import torch

    return getattr(torch, name)


def hypot(x: Any, y: Any) -> Any:
    """Length of (x, y) with a gradient at zero, too: a ray on the optical axis has one."""
    return (x * x + y * y + _TINY).sqrt()


def is_tensor(values: Any) -> bool:
    """Whether they are a tensor; does not load PyTorch."""
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(values, torch.Tensor)


def namespace(values: Any) -> Any:
    """What computes with values: NumPy, or this module for tensors."""
    return sys.modules[__name__] if is_tensor(values) else np


def on_tensors(method: Method) -> Method:
    """Let a method of a lens take tensors; it computes in double precision, in NumPy and PyTorch.

    A tensor of floats is given back in its own precision and on its own device.
    """

    @wraps(method)
    def converted(self: Any, values: Any) -> Any:
        if not is_tensor(values):
            return method(self, np.asarray(values, float))
        found = method(self, values.double())
        return found.to(values.dtype) if values.is_floating_point() else found

    return converted  # type: ignore[return-value]


def solved(
    solve: Callable[[np.ndarray], np.ndarray],
    newton_step: Callable[[Any, Any], Any],
    target: Any,
) -> Any:
    """Solution x of f(x) = target; that of a tensor has the gradient of the inverse function.

    With x held fixed, the gradient of ``x - newton_step(x, target)`` is that of the inverse of f.

    Args:
        solve: Finds x to rounding, on arrays.
        newton_step: ``(f(x) - target) / f'(x)``.
        target: Array or tensor.
    """
    if not is_tensor(target):
        return solve(target)
    import torch

    found = torch.from_numpy(np.asarray(solve(target.detach().cpu().numpy())))
    found = found.to(target.device)
    has_none = found.isnan()
    start = found.masked_fill(has_none, 0.0)  # NaN would enter the gradients of all
    return (start - newton_step(start, target)).masked_fill(has_none, torch.nan)
