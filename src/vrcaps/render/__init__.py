"""Rendering: images of a world with exact labels, in the compiled core.

`renderer.Renderer` renders a `frame.Frame` under `settings.RenderSettings`. `flow` computes optical
flow, `refraction` apparent points at pool surfaces, `scattering` the tissue's optics; `mucus_film`,
`imaging`, `narrow_band` and `led_light` change the wall's appearance before rendering.
"""
