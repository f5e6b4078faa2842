"""Capsule endoscopes as data: body, cameras, LEDs and magnets.

`device.Device` is the data type. `device_file.read_device` reads a device of the catalog in
`devices/` or a custom TOML file.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
