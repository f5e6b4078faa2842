"""Capsule endoscopes as data: body, cameras, LEDs and magnets.

`device.Device` is the data type, `body` its shape. `catalog.read_device` reads a device of the
catalog in `devices/` or a custom TOML file as described in `device_file`.
"""
