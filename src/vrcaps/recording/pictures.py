"""Visualization of channels: color maps, contact sheet and preview video of an episode."""

from __future__ import annotations

import io
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.color import turbo
from vrcaps.core.errors import import_extra
from vrcaps.core.units import MM
from vrcaps.render.channels import CHANNELS

if TYPE_CHECKING:
    from jaxtyping import UInt8
    from numpy.typing import NDArray

    from vrcaps.recording.episode import Episode

_BACKGROUND = np.array([24, 24, 28], np.uint8)
_TEXT = (230, 230, 230)
_TILE_HEIGHT = 160
_MARGIN, _LINE, _TITLE = 6, 16, 30
_MAX_WIDTH = 1800


def picture(
    channel: str, values: NDArray, limits: tuple[float, float] = (0.0, 1.0)
) -> UInt8[np.ndarray, "h w 3"]:
    """Render a channel's values as an sRGB picture; pixels without a value are dark gray.

    Args:
        channel: Name of the channel.
        values: Values as returned by `Episode.image`.
        limits: Values at both ends of the color map.
    """
    display = CHANNELS[channel].display
    if display == "image":
        return values
    if display in ("class", "instance"):
        return _class_colors()[values.astype(int) % 256]
    if display == "index":
        return np.where(values[..., None] < 0, _BACKGROUND, _class_colors()[values % 255 + 1])
    if display == "mask":
        return np.repeat(np.where(values, np.uint8(255), np.uint8(64))[..., None], 3, axis=-1)
    low, high = limits
    valid = np.isfinite(values) if values.ndim == 2 else np.all(np.isfinite(values), axis=-1)
    if display == "flow":
        colors = _flow_colors(values, high)
    else:
        fraction = np.nan_to_num((values - low) / max(high - low, 1e-12))
        fraction = fraction ** (1 / 2.2) if display == "color" else fraction
        colors = (np.clip(fraction, 0.0, 1.0) * 255.0).astype(np.uint8)
        if display == "scalar":
            colors = (turbo(colors / 255.0) * 255.0 + 0.5).astype(np.uint8)
    return np.where(valid[..., None], colors, _BACKGROUND)


def limits_of(channel: str, images: list[NDArray]) -> tuple[float, float]:
    """Color map limits that suit some images of a channel."""
    low, high = CHANNELS[channel].limits
    if low is not None and high is not None:
        return low, high
    values = np.concatenate([image[np.isfinite(image)].ravel() for image in images])
    if values.size == 0:
        return 0.0, 1.0
    if CHANNELS[channel].display == "flow":
        return 0.0, float(np.percentile(np.abs(values), 98.0)) or 1.0
    lowest, highest = np.percentile(values, [1.0, 99.0])
    return (float(lowest) if low is None else low), float(highest)


def contact_sheet(episode: Episode) -> UInt8[np.ndarray, "h w 3"]:
    """Contact sheet: a labeled row for each channel of each camera, over the whole run."""
    from PIL import Image, ImageDraw, ImageFont

    rows = [(camera, channel) for camera in episode.cameras for channel in episode.channels]
    widths = [round(c.width * _TILE_HEIGHT / c.height) for c in episode.cameras]
    columns = min(max((_MAX_WIDTH - _MARGIN) // (max(widths) + _MARGIN), 1), len(episode))
    chosen = np.unique(np.linspace(0, len(episode) - 1, columns).round().astype(int))
    width = max(_MARGIN + len(chosen) * (max(widths) + _MARGIN), 480)
    row_height = _LINE + _TILE_HEIGHT + _MARGIN
    sheet = Image.new("RGB", (width, _TITLE + len(rows) * row_height), tuple(_BACKGROUND.tolist()))
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(12)
    draw.text((_MARGIN, 8), _title(episode, chosen), fill=_TEXT, font=font)
    for row, (camera, channel) in enumerate(rows):
        top = _TITLE + row * row_height
        images = [episode.image(camera.name, channel, int(frame)) for frame in chosen]
        limits = limits_of(channel, images)
        caption = f"{camera.name} · {channel}{legend(channel, images, limits, episode.label_names)}"
        draw.text((_MARGIN, top), caption, fill=_TEXT, font=font)
        tile = (round(camera.width * _TILE_HEIGHT / camera.height), _TILE_HEIGHT)
        for column, image in enumerate(images):
            tile_image = Image.fromarray(np.ascontiguousarray(picture(channel, image, limits)))
            is_categorical = CHANNELS[channel].is_categorical
            method = Image.Resampling.NEAREST if is_categorical else Image.Resampling.BOX
            left = _MARGIN + column * (max(widths) + _MARGIN)
            sheet.paste(tile_image.resize(tile, method), (left, top + _LINE))
    return np.asarray(sheet)


def _title(episode: Episode, chosen: np.ndarray) -> str:
    times = ", ".join(f"{episode.times[i]:.2f}" for i in chosen)
    head = episode.head
    names = f"{head['organ']['name']} · {head['capsule']['name']}"
    return f"{names} · {len(episode)} frames · at {times} s"


def legend(
    channel: str,
    images: list[NDArray],
    limits: tuple[float, float],
    label_names: tuple[str, ...],
) -> str:
    """Legend of a channel's pictures, appended to its name.

    Args:
        channel: Name of the channel.
        images: Images shown.
        limits: Values at both ends of the color map.
        label_names: Class names of `label` by index.
    """
    declared, (low, high) = CHANNELS[channel], limits
    if declared.display == "scalar":
        return f", {low / MM:.0f} to {high / MM:.0f} mm (blue to red)"
    if declared.display == "flow":
        return f", hue is direction, up to {high:.1f} px"
    if declared.class_names:
        return f": {', '.join(declared.class_names[1:])}"
    if declared.display not in ("class", "instance"):
        return ""
    values = np.unique(np.concatenate([np.unique(image) for image in images]))
    if declared.display == "class":
        return f": {', '.join(label_names[i] for i in values if i > 0)}"
    return f": {', '.join(str(i) for i in values if i > 0) or 'none'}"


def _class_colors() -> UInt8[np.ndarray, "256 3"]:
    """Distinct colors: hues a golden angle apart; class 0 is the background."""
    colors = _hue_colors(np.arange(256) * 0.618033988749895, 0.85 - 0.25 * (np.arange(256) % 2))
    colors[0] = _BACKGROUND
    return colors


def _flow_colors(flow: NDArray, largest: float) -> UInt8[np.ndarray, "h w 3"]:
    flow = np.nan_to_num(flow)
    size = np.clip(np.linalg.norm(flow, axis=-1) / max(largest, 1e-12), 0.0, 1.0)
    return _hue_colors(np.arctan2(flow[..., 1], flow[..., 0]) / (2.0 * np.pi), size)


def _hue_colors(hue: NDArray, value: NDArray) -> NDArray:
    """Saturated colors of a hue (1 is a full turn) and a brightness from 0 to 1."""
    phase = (hue[..., None] + np.array([0.0, 2.0 / 3.0, 1.0 / 3.0])) % 1.0 * 6.0
    channel = np.clip(np.abs(phase - 3.0) - 1.0, 0.0, 1.0)
    return ((0.2 + 0.8 * channel) * value[..., None] * 255.0).astype(np.uint8)


class Preview:
    """Video encoded in memory; the same pictures give the same bytes."""

    def __init__(
        self, *, fps: float, width: int, height: int, crf: int = 24, key_interval: int = 60
    ) -> None:
        """Start a video of pictures up to the given size.

        Args:
            fps: Frames per second.
            width: Total width of a frame's pictures [px].
            height: Height of the tallest picture [px].
            crf: Constant rate factor of VP9: 0 is best, 63 smallest.
            key_interval: Frames from one key frame to the next.
        """
        av = import_extra("av", "video")

        self._buffer = io.BytesIO()
        self._size = (height + height % 2, width + width % 2)  # 4:2:0 needs even sizes
        self._container = av.open(
            self._buffer, "w", format="mp4", container_options={"fflags": "+bitexact"}
        )
        rate = Fraction(fps).limit_denominator(1000)
        self._stream = self._container.add_stream("libvpx-vp9", rate=rate)
        self._stream.height, self._stream.width = self._size
        self._stream.pix_fmt = "yuv420p"
        # One thread: with more, the bytes depend on the number of threads.
        self._stream.codec_context.thread_count = 1
        self._stream.options = {
            "deadline": "realtime",
            "cpu-used": "8",
            "crf": str(crf),
            "b": "0",
            "g": str(key_interval),
            "flags": "+bitexact",
        }

    def add(self, pictures: list[UInt8[np.ndarray, "h w 3"]]) -> None:
        """Add a frame: one picture per camera, left to right."""
        av = import_extra("av", "video")

        canvas = np.zeros((*self._size, 3), np.uint8)
        left = 0
        for picture in pictures:
            canvas[: picture.shape[0], left : left + picture.shape[1]] = picture
            left += picture.shape[1]
        self._container.mux(self._stream.encode(av.VideoFrame.from_ndarray(canvas, format="rgb24")))

    def finish(self) -> bytes:
        """Finish encoding and return the video file."""
        self._container.mux(self._stream.encode(None))
        self._container.close()
        return self._buffer.getvalue()


def require_preview(path: Path, frames: int) -> None:
    """Check that a file is a video of this number of frames.

    Raises:
        OSError: If it cannot be read.
        ValueError: If it is not such a video.
    """
    av = import_extra("av", "video")
    FFmpegError = import_extra("av.error", "video").FFmpegError

    try:
        with av.open(str(path)) as container:
            count = container.streams.video[0].frames
    except (FFmpegError, IndexError) as error:
        raise ValueError(f"not a complete video: {error}") from error
    if count != frames:
        raise ValueError(f"a video of {count} frames, not {frames}")
