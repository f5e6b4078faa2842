from .device import PHOSPHOR as PHOSPHOR
from .device import Body as Body
from .device import Device as Device
from .device import homogeneous_body as homogeneous_body
from .device_file import LedRing as LedRing
from .device_file import device_names as device_names
from .device_file import read_device as read_device
from .device_file import write_device as write_device
