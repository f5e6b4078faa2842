from .patches import PhotoScale as PhotoScale
from .report import write_report as write_report
from .texture import TextureOptions as TextureOptions
from .texture import TextureResult as TextureResult
from .texture import make_texture as make_texture
from .vessels import VesselPlacement as VesselPlacement
