"""Offline tools around the simulator; the simulator never imports them.

`ct/` makes organs from CT scans, `mucosa_from_photos/` textures from endoscopic photographs,
`camera_calibration/` and `photometric_calibration/` devices from images of a real capsule,
`overview/` pictures of an organ. `photos` reads photographs, `field_of_view` masks them.
"""
