"""Small DICOM files, element by element: explicit VR, little endian, not compressed."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

Elements = dict[tuple[int, int], tuple[str, str | int | bytes]]
"""Value representation and value by group and element."""

SOP_CLASS, SOP_UID, PHOTOMETRIC = (0x0008, 0x0016), (0x0008, 0x0018), (0x0028, 0x0004)
MODALITY, POSITION, ORIENTATION = (0x0008, 0x0060), (0x0020, 0x0032), (0x0020, 0x0037)
THICKNESS, SPACING, FRAMES = (0x0018, 0x0050), (0x0028, 0x0030), (0x0028, 0x0008)
SAMPLES, ROWS, COLUMNS = (0x0028, 0x0002), (0x0028, 0x0010), (0x0028, 0x0011)
BITS, STORED, HIGH_BIT, SIGNED = ((0x0028, 0x0100 + k) for k in range(4))
INTERCEPT, SLOPE, PIXELS = (0x0028, 0x1052), (0x0028, 0x1053), (0x7FE0, 0x0010)

_CT, _LITTLE_ENDIAN = "1.2.840.10008.5.1.4.1.1.2", "1.2.840.10008.1.2.1"
_LONG = {"OB", "OW", "SQ", "UN"}


def slice_elements(hounsfield: np.ndarray, number: int) -> Elements:
    """Elements of one axial slice of 1.5 mm pixels, 2 mm above the one before."""
    rows, columns = hounsfield.shape
    return {
        SOP_CLASS: ("UI", _CT),
        SOP_UID: ("UI", f"1.2.3.{number + 1}"),
        MODALITY: ("CS", "CT"),
        THICKNESS: ("DS", "2"),
        (0x0020, 0x000D): ("UI", "1.2.4"),
        (0x0020, 0x000E): ("UI", "1.2.5"),
        POSITION: ("DS", f"-6\\-6\\{2 * number}"),
        ORIENTATION: ("DS", "1\\0\\0\\0\\1\\0"),
        SAMPLES: ("US", 1),
        PHOTOMETRIC: ("CS", "MONOCHROME2"),
        ROWS: ("US", rows),
        COLUMNS: ("US", columns),
        SPACING: ("DS", "1.5\\1.5"),
        BITS: ("US", 16),
        STORED: ("US", 16),
        HIGH_BIT: ("US", 15),
        SIGNED: ("US", 0),
        INTERCEPT: ("DS", "-1024"),
        SLOPE: ("DS", "1"),
        PIXELS: ("OW", (hounsfield + 1024).astype("<u2").tobytes()),
    }


def write_elements(path: Path, elements: Elements) -> Path:
    """Write a DICOM file with a preamble and the meta information that it needs."""
    meta: Elements = {
        (0x0002, 0x0001): ("OB", b"\0\1"),
        (0x0002, 0x0002): ("UI", elements[SOP_CLASS][1]),
        (0x0002, 0x0003): ("UI", elements[SOP_UID][1]),
        (0x0002, 0x0010): ("UI", _LITTLE_ENDIAN),
        (0x0002, 0x0012): ("UI", "1.2.6"),
    }
    packed = _packed(meta)
    head = _packed({(0x0002, 0x0000): ("UL", len(packed))})
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(bytes(128) + b"DICM" + head + packed + _packed(elements))
    return path


def _packed(elements: Elements) -> bytes:
    data = b""
    for tag, (kind, value) in sorted(elements.items()):
        content = _content(kind, value)
        size = "<2xI" if kind in _LONG else "<H"
        data += struct.pack("<HH2s", *tag, kind.encode())
        data += struct.pack(size, len(content)) + content
    return data


def _content(kind: str, value: str | int | bytes) -> bytes:
    if isinstance(value, int):
        return struct.pack("<I" if kind == "UL" else "<H", value)
    if isinstance(value, str):
        return value.encode() + (b"\0" if kind == "UI" else b" ") * (len(value) % 2)
    return value
