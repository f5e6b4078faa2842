"""Lenses on PyTorch tensors: the same formulas, with gradients by autograd.

Lens methods decorated with `on_tensors` accept tensors as well as arrays. They compute with the
result of `namespace`: NumPy, or this module, whose functions are PyTorch's. An inverse without
closed form is solved by NumPy; one more Newton step in PyTorch gives its gradient.
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
    """PyTorch function that accepts the arguments of its NumPy counterpart."""
    if name.startswith("_"):  # the import system requests such names
        raise AttributeError(name)
    import torch

    return getattr(torch, name)


def hypot(x: Any, y: Any) -> Any:
    """Length of (x, y) with a defined gradient at zero, where a ray on the optical axis lies."""
    return (x * x + y * y + _TINY).sqrt()


def is_tensor(values: Any) -> bool:
    """Check whether values are a tensor, without loading PyTorch."""
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(values, torch.Tensor)


def namespace(values: Any) -> Any:
    """Return the namespace for values: NumPy, or this module for tensors."""
    return sys.modules[__name__] if is_tensor(values) else np


def on_tensors(method: Method) -> Method:
    """Let a lens method accept tensors; it computes in double precision, in NumPy and PyTorch.

    A floating-point tensor is returned in its own precision and on its own device.
    """

    @wraps(method)
    def converted(self: Any, values: Any) -> Any:
        if not is_tensor(values):
            return method(self, np.asarray(values, float))
        result = method(self, values.double())
        return result.to(values.dtype) if values.is_floating_point() else result

    return converted  # type: ignore[return-value]


def solved(
    solve: Callable[[np.ndarray], np.ndarray],
    newton_step: Callable[[Any, Any], Any],
    target: Any,
) -> Any:
    """Solve f(x) = target; the solution for a tensor has the gradient of the inverse function.

    With x held fixed, the gradient of ``x - newton_step(x, target)`` is that of the inverse of f.

    Args:
        solve: Solver for x on arrays, accurate to rounding.
        newton_step: ``(f(x) - target) / f'(x)``.
        target: Array or tensor.
    """
    if not is_tensor(target):
        return solve(target)
    import torch

    solution = torch.from_numpy(np.asarray(solve(target.detach().cpu().numpy())))
    solution = solution.to(target.device)
    has_none = solution.isnan()
    start = solution.masked_fill(has_none, 0.0)  # NaN would spread to all gradients
    return (start - newton_step(start, target)).masked_fill(has_none, torch.nan)
