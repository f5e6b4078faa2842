"""Offline tools around the simulator; the simulator never imports them.

`ct` builds organs from CT scans, `mucosa_from_photos` textures from endoscopic photographs,
`camera_calibration` and `photometric_calibration` devices from images of a real capsule.
`reconstruction` estimates the wall from images, by fusion of depth or by stitching. `reports` draws
organs, coverage, evaluations and data sets; `report` contains their plots and HTML. `scene` writes
an episode for physics engines, `photos` reads and masks photographs.
"""
