from .patches import PhotoScale as PhotoScale
from .texture import TextureOptions as TextureOptions
from .texture import TextureResult as TextureResult
from .texture import make_texture as make_texture
from .texture import write_report as write_report
from .vessels import VesselPlacement as VesselPlacement
