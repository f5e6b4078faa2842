from .calibrate import PhotometricCalibration as PhotometricCalibration
from .calibrate import calibrate_photometric as calibrate_photometric
from .calibrate import photometric_device as photometric_device
from .calibrate import write_report as write_report
from .calibrate import write_scenario as write_scenario
from .frames import jpeg_quality as jpeg_quality
from .frames import make_frames as make_frames
