"""Frames of one camera over time, from any source, and the class of a frame by its lesions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.camera.camera import Camera
from vrcaps.core.errors import InputError, UnknownNameError, reading
from vrcaps.core.geometry import require_rigid
from vrcaps.core.names import require_name
from vrcaps.lumen.particles import FIRST_CLUMP
from vrcaps.render.channels import CHANNELS, Frame

if TYPE_CHECKING:
    from jaxtyping import Float, Int, UInt16
    from numpy.typing import NDArray

SPLITS = ("train", "val", "test")
"""Splits of a data set."""
_LATEST = 1e12
"""Maximum valid time [s]; times in seconds since 1970 are below 1e10."""
TIME, CAMERA_POSE = "time", "T_world_camera"
"""Names of values used by sequences of all sources."""
EXPOSURE = "exposure"
"""Name of the exposure of each frame, relative to the camera's own, where it is automatic. NaN is
an unknown exposure."""


@dataclass(frozen=True)
class FrameSequence:
    """Frames of one camera over time, of an episode or an external data set.

    Images are read on demand. `sequence[i]` is a dictionary of arrays and scalars, none of them
    None: an array for each channel, the values of the frame, and `index`. It needs no PyTorch,
    but PyTorch's `DataLoader` takes it as a map-style dataset.

    Example:
        >>> sequence = vrcaps.read_episode("runs/colon").sequence("front", ("rgb", "depth"))
        >>> sequence[0]["depth"], sequence[0]["T_world_camera"]
        >>> loader = torch.utils.data.DataLoader(sequence)

    External data are validated here, because names become paths of written files and networks are
    trained on the values.

    Attributes:
        name: Name in its source, a relative path.
        channels: Image channels that a frame has, in the order of `Frame`.
        values: An array with a row per frame for each known quantity. `time` [s] is always
            present; `T_world_camera` [m] if poses are known; an episode also has
            `T_world_capsule` and `capsule_arc_length` [m]; a folder of images has `file_name`,
            without the extension.
        load: Reads an image in SI units, given channel and frame index.
        camera: Lens and size of the images; None if the source has no calibration.
        label_names: Class names of `label` by index; 0 is `background`.
        patient: Patient ID, by which data sets are split; None if unknown.
        split: `train`, `val` or `test`; None if the source has no splits.
        episode: `Episode` that it belongs to; None for external data.

    Raises:
        InputError: If the name is not a relative path, a value does not have one row per frame, a
            time is not finite, or a transform `T_…` is not rigid.
        UnknownNameError: If there is no such channel or split.
    """

    name: str
    channels: tuple[str, ...]
    values: Mapping[str, NDArray]
    load: Callable[[str, int], NDArray] = field(repr=False)
    camera: Camera | None = None
    label_names: tuple[str, ...] = ()
    patient: str | None = None
    split: str | None = None
    episode: Any = field(default=None, repr=False)

    def __post_init__(self) -> None:
        require_name("sequence", self.name)
        if self.split not in (None, *SPLITS):
            raise UnknownNameError(f"split of {self.name}", str(self.split), SPLITS)
        for channel in self.channels:
            if channel not in CHANNELS:
                raise UnknownNameError("channel", str(channel), CHANNELS)
        _require_values(self)

    def __repr__(self) -> str:
        return f"FrameSequence({self.name!r}, frames={len(self)}, channels={self.channels})"

    def __len__(self) -> int:
        return len(self.values[TIME])

    def __iter__(self) -> Iterator[dict[str, NDArray]]:
        return (self[index] for index in range(len(self)))

    def __getitem__(self, index: int) -> dict[str, NDArray]:
        """Return the arrays of one frame; a negative index counts from the end.

        Raises:
            IndexError: If there is no such frame, so that a loop over the sequence ends.
            InputError: If a file cannot be read or holds an impossible value.
        """
        if not -len(self) <= index < len(self):
            raise IndexError(f"No frame {index}. Allowed: 0 to {len(self) - 1}.")
        k = index % len(self)
        images = {channel: self._loaded(channel, k) for channel in self.channels}
        values = {name: np.asarray(rows[k]) for name, rows in self.values.items()}
        return images | values | {"index": np.asarray(k)}

    @property
    def times(self) -> Float[np.ndarray, " n"]:
        """Time of each frame [s]."""
        return self.values[TIME]

    @property
    def Ts_world_camera(self) -> Float[np.ndarray, "n 4 4"]:
        """Pose of the camera at each frame [m].

        Raises:
            InputError: If poses are unknown.
        """
        if CAMERA_POSE not in self.values:
            raise InputError(f"{self.name} has no poses of its camera.")
        return self.values[CAMERA_POSE]

    def image(self, channel: str, index: int) -> NDArray:
        """Return one channel [h w] or [h w c] of a frame in SI units; NaN where there is no value.

        Raises:
            UnknownNameError: If the sequence has no such channel.
            InputError: If there is no such frame, or its file cannot be read or holds an infinite
                value or a negative distance.
        """
        self._require_channels((channel,))
        if not 0 <= index < len(self):
            raise InputError(f"No frame {index} in {self.name}. Allowed: 0 to {len(self) - 1}.")
        return self._loaded(channel, index)

    def frame(self, index: int) -> Frame:
        """Return all channels of one frame."""
        return Frame(**{channel: self.image(channel, index) for channel in self.channels})

    def subset(self, frames: Sequence[int] | Int[np.ndarray, " n"]) -> FrameSequence:
        """Return the sequence of some frames, given by index; they are renumbered from 0."""
        kept = np.asarray(frames, int)
        return replace(
            self,
            values={name: rows[kept] for name, rows in self.values.items()},
            load=lambda channel, index: self.load(channel, int(kept[index])),
        )

    def with_channels(self, channels: Iterable[str]) -> FrameSequence:
        """Return the same frames with these channels only.

        Raises:
            UnknownNameError: If a channel does not exist.
        """
        chosen = tuple(channels)
        self._require_channels(chosen)
        return replace(self, channels=tuple(name for name in CHANNELS if name in chosen))

    def _loaded(self, channel: str, index: int) -> NDArray:
        what = f"{channel} of frame {index} of {self.name}"
        with reading(what):
            image = self.load(channel, index)
            _require_possible(channel, image, what)
        return image

    def _require_channels(self, channels: Sequence[str]) -> None:
        for channel in channels:
            if channel not in self.channels:
                raise UnknownNameError("channel", channel, self.channels)


def _require_values(sequence: FrameSequence) -> None:
    """Check times and transforms of a sequence.

    Raises:
        InputError: If one is invalid; the message names the sequence and the frame.
    """
    times = np.asarray(sequence.values[TIME])
    for name, rows in sequence.values.items():
        if len(rows) != len(times):
            raise InputError(
                f"{sequence.name} has {len(rows)} values of {name} for {len(times)} frames."
            )
        if name.startswith("T_"):
            require_rigid(rows, f"{name} of {sequence.name}")
    wrong = np.flatnonzero(~(np.abs(times.astype(float)) < _LATEST))
    if len(wrong):
        raise InputError(
            f"The time of frame {wrong[0]} of {sequence.name} is {times[wrong[0]]}. Allowed: a "
            f"number of seconds below {_LATEST:g}."
        )


def _require_possible(channel: str, image: NDArray, what: str) -> None:
    """Check the values of an image: floats are finite or NaN, distances not negative.

    Raises:
        InputError: If a pixel is invalid.
    """
    if image.dtype.kind != "f":
        return
    if np.isinf(image).any():
        raise InputError(
            f"{what} contains an infinite value. Allowed: finite values, or NaN for none."
        )
    encoding = CHANNELS[channel].encoding
    if encoding.unit == "m" and encoding.components == 1 and (image < 0.0).any():
        raise InputError(
            f"{what} contains a negative distance. Allowed: 0 or more, or NaN for none."
        )


NORMAL = "normal"
"""Class of images without a lesion."""


def image_class(
    instance: UInt16[np.ndarray, "h w"], lesions: Sequence[dict[str, Any]], min_fraction: float
) -> str | None:
    """Kind of the largest lesion in an image, or `NORMAL`; None if the largest is too small.

    Args:
        instance: Lesion ID of each pixel.
        lesions: Lesions of the organ, as in `organ.lesions` of an episode.
        min_fraction: Fraction of the image that the lesion must cover.
    """
    pixels = np.bincount(lesion_instances(instance).ravel())[1:]
    if not pixels.any():
        return NORMAL
    if pixels.max() < min_fraction * instance.size:
        return None
    kinds = {one["instance"]: one["kind"] for one in lesions}
    return kinds.get(int(pixels.argmax()) + 1)


def lesion_instances(instance: UInt16[np.ndarray, "h w"]) -> UInt16[np.ndarray, "h w"]:
    """Lesion ID of each pixel of a recording; 0 also where it shows a clump of chyme."""
    return np.where(instance < FIRST_CLUMP, instance, np.uint16(0))
