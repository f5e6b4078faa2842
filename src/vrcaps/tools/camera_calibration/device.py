"""Calibrated lens in a device that is ready to be written to a file."""

from __future__ import annotations

from dataclasses import replace

from vrcaps.camera.camera import Camera
from vrcaps.capsule.device import Device
from vrcaps.core.errors import UnknownNameError
from vrcaps.tools.camera_calibration.fit import Calibration


def find_camera(device: Device, name: str | None) -> Camera:
    """Return a camera of a device by name; the first if the name is None.

    Raises:
        UnknownNameError: If the device has no such camera.
    """
    cameras = {camera.name: camera for camera in device.cameras}
    if name is not None and name not in cameras:
        raise UnknownNameError(f"camera of {device.name}", name, cameras)
    return device.cameras[0] if name is None else cameras[name]


def with_camera(device: Device, old: Camera, new: Camera) -> Device:
    """Copy of a device with one camera replaced."""
    cameras = tuple(new if camera is old else camera for camera in device.cameras)
    return replace(device, cameras=cameras)


def calibrated_device(
    pattern: Device, fit: Calibration, *, camera: str | None = None, circle_px: float | None = None
) -> Device:
    """Copy of a device whose camera has the fitted lens and the photographs' size.

    Args:
        pattern: Provides body, magnets, LEDs, positions and exposure.
        fit: The lens.
        camera: Name of the camera to change; by default the first.
        circle_px: Radius about the lens's center beyond which the sensor is dark.

    Raises:
        UnknownNameError: If the pattern has no such camera.
    """
    old = find_camera(pattern, camera)
    width, height = fit.size
    new = replace(
        old,
        **{"lens": fit.lens, "width": width, "height": height},
        image_circle_px=circle_px,
        nominal_field=None,
    )
    source = (
        f"Lens of camera {old.name}: {fit.lens.kind} model fitted to {len(fit.views)} photographs "
        f"of a chessboard, mean error {fit.errors.mean():.3f} px. All else as in {pattern.name}: "
        f"{pattern.source.strip()}"
    )
    names = (view.name for view in fit.views)
    facts = {
        "photographs": list(names),
        "mean_error_px": round(float(fit.errors.mean()), 4),
        "deviations": {
            name: float(f"{spread:.3g}")
            for name, spread in zip(fit.names, fit.deviations.tolist(), strict=True)
        },
    }
    changed = with_camera(pattern, old, new)
    metadata = {**pattern.metadata, "calibration": facts}
    title = f"{pattern.title}, lens calibrated"
    return replace(changed, title=title, source=source, metadata=metadata)
