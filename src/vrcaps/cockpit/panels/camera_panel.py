"""Camera panel: live images of the capsule's cameras, in any channel."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.cockpit.camera_images import LIVE_CHANNELS, LiveImage

if TYPE_CHECKING:
    from vrcaps.cockpit.page import Page
    from vrcaps.cockpit.view import View

_QUALITY = 80


class CameraPanel:
    """Panel of the live image."""

    def __init__(self, page: Page) -> None:
        self._page = page
        cameras = page.session.model.device.cameras
        gui = page.server.gui
        with page.side_panel.add_tab("Camera"):
            blank = np.zeros((cameras[0].height, cameras[0].width, 3), np.uint8)
            self._image = gui.add_image(blank, format="jpeg", jpeg_quality=_QUALITY)
            camera = gui.add_dropdown("Camera", tuple(each.name for each in cameras))
            channel = gui.add_dropdown("Channel", LIVE_CHANNELS)

        @camera.on_update
        @channel.on_update
        @page.handler
        def _(event: object) -> None:
            del event
            look = replace(page.images.look, camera=camera.value, channel=channel.value)
            page.images.look = look

    def show_image(self, image: LiveImage) -> None:
        """Show an image of the camera; called from the rendering thread."""
        self._image.image = image.picture
        self._page.server.flush()  # otherwise the page's library waits for further updates

    def update(self, view: View) -> None:
        """Do nothing: images arrive separately."""
