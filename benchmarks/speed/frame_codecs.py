"""Size, time and readers of image files by codec, for a labeled frame.

Renders frames of a flight through the default colon and codes each channel in memory, so that no
disk counts. Times are of one processor. Writes a section of docs/concepts/datasets.md. For example:
``python -m benchmarks.speed.frame_codecs --size 12``.
"""

from __future__ import annotations

import io
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow
from PIL import Image

from benchmarks.common.scripts import options, table, write_section
from vrcaps import _core
from vrcaps.motion.fly_through import FlyThrough
from vrcaps.render.channels import CHANNELS
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings
from vrcaps.scenario.build import build
from vrcaps.scenario.scenario import DEFAULT_CHANNELS, Scenario


@dataclass(frozen=True)
class Codec:
    """Lossless encoding of the values of an image.

    Attributes:
        name: As the table prints it.
        encode: Bytes of an array.
        decode: The array of bytes and of one like it.
        opens: Who opens such a file.
    """

    name: str
    encode: Callable[[np.ndarray], bytes]
    decode: Callable[[bytes, np.ndarray], np.ndarray]
    opens: str


def _npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def _npz(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, image=array)
    return file.getvalue()


def _pillow_png(array: np.ndarray) -> bytes:
    """Slow PNG; Pillow has no 16-bit colors, so their bytes are stored side by side."""
    file = io.BytesIO()
    shown = array.view(np.uint8).reshape(len(array), -1) if _is_wide_color(array) else array
    Image.fromarray(shown).save(file, "PNG", compress_level=6)
    return file.getvalue()


def _from_pillow(data: bytes, like: np.ndarray) -> np.ndarray:
    found = np.asarray(Image.open(io.BytesIO(data)))
    return found.view(like.dtype).reshape(like.shape) if _is_wide_color(like) else found


def _is_wide_color(array: np.ndarray) -> bool:
    return array.ndim == 3 and array.dtype == np.uint16


def _arrow(codec: str) -> Codec:
    def decode(data: bytes, like: np.ndarray) -> np.ndarray:
        raw = pyarrow.decompress(data, like.nbytes, codec, asbytes=True)
        return np.frombuffer(raw, like.dtype).reshape(like.shape)

    def encode(array: np.ndarray) -> bytes:
        return pyarrow.compress(array.tobytes(), codec, asbytes=True)

    return Codec(
        f"numbers in {codec}", encode, decode, f"programs that know the layout, by {codec}"
    )


CODECS = (
    Codec(
        "**PNG, as written** (fdeflate, Paeth)",
        lambda array: _core.encode_pngs([array])[0],
        lambda data, _: _core.decode_pngs([np.frombuffer(data, np.uint8)])[0],
        "everything",
    ),
    Codec("PNG, zlib level 6", _pillow_png, _from_pillow, "everything"),
    Codec("`.npy`", _npy, lambda data, _: np.load(io.BytesIO(data)), "NumPy"),
    Codec("`.npz`, deflated", _npz, lambda data, _: np.load(io.BytesIO(data))["image"], "NumPy"),
    _arrow("lz4"),
    _arrow("zstd"),
)


def stored_frames(count: int) -> list[dict[str, np.ndarray]]:
    """Stored numbers of the channels of some frames."""
    model, motion = build(
        Scenario(
            frames=count,
            motion=FlyThrough(whole=True),
            render=RenderSettings(light="direct", shadows=False),
        )
    )
    renderer, camera = Renderer(model), model.device.cameras[0]
    frames = []
    for step in motion.steps():
        frame = renderer.render(step.state, camera, channels=DEFAULT_CHANNELS)
        frames.append(
            {
                name: CHANNELS[name].encoding.encode(getattr(frame, name))
                for name in DEFAULT_CHANNELS
            }
        )
    return frames


def measure(codec: Codec, images: list[np.ndarray]) -> tuple[float, float, float]:
    """Mean size [kB], and processor time [ms] to code and to read."""
    codec.encode(images[0])
    began = time.process_time()
    files = [codec.encode(image) for image in images]
    coded = time.process_time()
    found = [codec.decode(data, image) for data, image in zip(files, images, strict=True)]
    read = time.process_time()
    for one, image in zip(found, images, strict=True):
        assert np.array_equal(one, image), codec.name
    per = 1e3 / len(images)
    return sum(map(len, files)) / len(files) / 1e3, (coded - began) * per, (read - coded) * per


def main() -> None:
    """Measure and write."""
    given = options(__doc__ or "", 12)
    frames = stored_frames(given.size)
    rows = []
    for codec in CODECS:
        found = {n: measure(codec, [f[n] for f in frames]) for n in DEFAULT_CHANNELS}
        sizes = [f"{size:.0f}" for size, _, _ in found.values()]
        totals = [f"{sum(column):.1f}" for column in zip(*found.values(), strict=True)]
        rows.append([codec.name, *sizes, *totals, codec.opens])
    shape = frames[0]["depth"].shape
    text = f"""## Image codecs

Mean of {given.size} frames of {shape[1]} × {shape[0]} pixels in the default colon:
kB of each channel and of all, and ms of one processor for all, without the disk.

"""
    head = ["codec", *(f"`{name}`" for name in DEFAULT_CHANNELS)]
    text += table([*head, "all [kB]", "write [ms]", "read [ms]", "opened by"], rows)
    write_section(given.out, Path(__file__), text)


if __name__ == "__main__":
    main()
