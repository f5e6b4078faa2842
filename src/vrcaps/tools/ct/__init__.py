"""Organs from CT: from DICOM series, volumes and label maps to a wall.

`read_volume` and `read_dicom` read scans. `lumen` segments the gas, `cleansing` handles tagged
fluid, `collapse_bridging` collapsed stretches. `fraction` measures partial volume, `surface`
extracts the wall, `from_ct` builds the organ.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
