"""Detection of dead layers: features that are the same for all images."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor, nn

from vrcaps.core.errors import InputError
from vrcaps.learn.checkpoint import TrainedNetwork
from vrcaps.learn.samples import batch_of
from vrcaps.learn.task import Sample


def dead_features(trained: TrainedNetwork, samples: Sequence[Sample]) -> dict[str, float]:
    """Fraction of dead input features of each convolution and linear layer, by its name.

    A feature is dead if it has one value for all samples and positions, such as after a ReLU whose
    inputs are all negative. No gradient passes such an activation, so it stays dead.

    Args:
        trained: Task and network.
        samples: Two or more samples whose images differ.
    """
    fractions: dict[str, float] = {}

    def observe(name: str) -> object:
        def hook(module: nn.Module, inputs: tuple[Tensor, ...]) -> None:
            values = inputs[0].detach().float()
            values = values.transpose(0, 1) if values.ndim == 4 else values.movedim(-1, 0)
            flat = values.flatten(1)
            is_dead = flat.amax(dim=1) == flat.amin(dim=1)
            fractions[name] = max(fractions.get(name, 0.0), float(is_dead.float().mean()))

        return hook

    hooks = [
        module.register_forward_pre_hook(observe(name))  # type: ignore[arg-type]
        for name, module in trained.network.named_modules()
        if isinstance(module, nn.Conv2d | nn.Linear)
    ]
    try:
        trained.outputs(batch_of(samples, trained.device))
    finally:
        for hook in hooks:
            hook.remove()
    return fractions


def require_alive(trained: TrainedNetwork, samples: Sequence[Sample], step: int) -> None:
    """Check that no layer of a network has only dead input features.

    Args:
        trained: Task and network.
        samples: Samples of the evaluation; equal images are not compared.
        step: Number of training steps, for the message.

    Raises:
        InputError: If a layer is dead.
    """
    distinct = {sample["image"].tobytes(): sample for sample in samples}
    if len(distinct) < 2:
        return
    for name, fraction in dead_features(trained, list(distinct.values())).items():
        if fraction == 1.0:
            raise InputError(
                f"The network is dead at step {step}: all inputs of its layer {name} are the same "
                "for all images. Start again with a smaller --set learning_rate, another --set "
                "seed, or other --start weights."
            )
