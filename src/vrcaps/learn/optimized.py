"""Network with its optimizer: gradient steps, and the state in a checkpoint."""

from __future__ import annotations

from typing import Any

from vrcaps.learn.networks import require_torch

_MAX_GRADIENT = 1.0
"""Maximum norm of the gradients, by clipping."""


class NetworkOptimizer:
    """A network that AdamW optimizes."""

    def __init__(self, network: Any, *, weight_decay: float, momentum: float = 0.9) -> None:
        """Initialize the optimizer.

        Args:
            network: Network on its device.
            weight_decay: Weight decay of AdamW.
            momentum: First beta coefficient of AdamW.
        """
        self.network = network
        self.optimizer = require_torch().optim.AdamW(
            network.parameters(), betas=(momentum, 0.999), weight_decay=weight_decay
        )

    def learn(self, loss: Any, rate: float) -> None:
        """Take one gradient step on a loss, at a learning rate."""
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        clip = require_torch().nn.utils.clip_grad_norm_
        clip(self.network.parameters(), _MAX_GRADIENT)
        self.optimizer.step()

    def state(self) -> dict[str, Any]:
        """State for a checkpoint."""
        return {"network": self.network.state_dict(), "optimizer": self.optimizer.state_dict()}

    def load(self, state: dict[str, Any]) -> None:
        """Restore a state."""
        self.network.load_state_dict(state["network"])
        self.optimizer.load_state_dict(state["optimizer"])
