"""Organs from CT: from DICOM series, volumes and label maps to a wall.

`read_volume` and `read_dicom` read scans. `lumen` segments the gas, `cleansing` handles tagged
fluid, `collapse_bridging` collapsed stretches. `fraction` measures partial volume, `surface`
extracts the wall, `from_ct` builds the organ.
"""
