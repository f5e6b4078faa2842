"""A network with its optimizer: how it learns from a loss, and its state in a checkpoint."""

from __future__ import annotations

from typing import Any

from vrcaps.learn.networks import require_torch

_MOST_GRADIENT = 1.0
"""Norm that gradients are cut down to."""


class Optimized:
    """A network that AdamW optimizes."""

    def __init__(self, network: Any, *, weight_decay: float, momentum: float = 0.9) -> None:
        """A network that has learned nothing.

        Args:
            network: On its device.
            weight_decay: Of AdamW.
            momentum: AdamW's first coefficient.
        """
        self.network = network
        self.optimizer = require_torch().optim.AdamW(
            network.parameters(), betas=(momentum, 0.999), weight_decay=weight_decay
        )

    def learn(self, loss: Any, rate: float) -> None:
        """One step down a loss, at a learning rate."""
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        clip = require_torch().nn.utils.clip_grad_norm_
        clip(self.network.parameters(), _MOST_GRADIENT)
        self.optimizer.step()

    def state(self) -> dict[str, Any]:
        """What a checkpoint holds."""
        return {"network": self.network.state_dict(), "optimizer": self.optimizer.state_dict()}

    def load(self, state: dict[str, Any]) -> None:
        """Go on from a state."""
        self.network.load_state_dict(state["network"])
        self.optimizer.load_state_dict(state["optimizer"])
