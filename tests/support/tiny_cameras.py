"""Cameras with few pixels."""

from geometry.sensors import CameraModel


def tiny_camera(width_px, height_px, *, name="small", fov_deg=90.0, near_m=0.35):
    """A pinhole camera of 10 Hz that costs nothing."""
    return CameraModel(
        name=name,
        width_px=width_px,
        height_px=height_px,
        horizontal_fov_deg=fov_deg,
        frame_rate_hz=10.0,
        near_m=near_m,
        price_eur=0.0,
    )
