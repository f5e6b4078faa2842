"""Draw the picture of LED spectra: places of a generated colon under three kinds of LEDs.

python -m docs.images.led_spectra
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import vrcaps
from docs.images.views import save_rows, view_row

WAVELENGTH_NM = np.arange(380.0, 701.0, 4.0)


def leds(*lines: tuple[float, float, float]) -> tuple[tuple[float, float], ...]:
    """Spectrum of LEDs, each with its peak and full width at half [nm] and its power there."""
    power = sum(p * np.exp(-2.77 * ((WAVELENGTH_NM - nm) / width) ** 2) for nm, width, p in lines)
    return tuple(zip(WAVELENGTH_NM.tolist(), np.asarray(power).tolist(), strict=True))


SPECTRA = {
    "usual": None,
    "red, green and blue": leds((630.0, 20.0, 1.0), (525.0, 35.0, 1.0), (465.0, 25.0, 1.0)),
    "violet below phosphor": leds((415.0, 20.0, 3.0), (560.0, 120.0, 1.0)),
}


def main(path: Path) -> None:
    """A row for each kind."""
    colon, device = vrcaps.generate_organ("colon", seed=0), vrcaps.read_device("mirocam")
    devices = [replace(device, led_spectrum=spectrum) for spectrum in SPECTRA.values()]
    save_rows([view_row(vrcaps.Model(colon, device)) for device in devices], path)


if __name__ == "__main__":
    main(Path(__file__).with_suffix(".jpg"))
