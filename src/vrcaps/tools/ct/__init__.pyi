from .from_ct import WallOptions as WallOptions
from .from_ct import find_lumens as find_lumens
from .from_ct import organ_from_gas as organ_from_gas
from .from_ct import organ_from_label as organ_from_label
from .lumen import choose_gas as choose_gas
from .scan_files import read_volume as read_volume
from .volume import Volume as Volume
