"""Organs from CT: DICOM series, volumes and label maps to a wall.

`read_volume` and `read_dicom` read scans, `lumen` finds the gas, `cleansing` and
`air_fluid_interface` tagged fluid, `collapse_bridging` collapsed stretches. `fraction` measures
partial volume, `surface` extracts the wall, `from_ct` makes the organ.
"""
