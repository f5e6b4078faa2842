"""Rendering: images of a world with exact labels, in the compiled core.

`renderer.Renderer` renders a `channels.Frame` under `settings.RenderSettings`, `batch` many at
once. `flow` computes optical flow, `refraction` apparent points at pool surfaces, `scattering` the
tissue's optics; `scene` and `imaging` prepare the wall's appearance.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
