"""Cameras with random lenses, and the same by another library's arithmetic."""

from dataclasses import replace

import numpy as np

from geometry.lenses import BrownConrady, Fisheye, Lens, TsaiRadial

MODELS = ("brown-conrady", "tsai", "fisheye")


def random_lens(rng, model: str) -> Lens:
    """One of any strength; some fold the picture within it."""
    k1, k2, k3, k4, p1, p2 = rng.uniform(-1.0, 1.0, 6) * [
        0.3,
        0.1,
        0.03,
        0.01,
        0.01,
        0.01,
    ]
    if model == "brown-conrady":
        return BrownConrady(
            k1=k1,
            k2=k2,
            k3=k3,
            p1=p1,
            p2=p2,
        )
    if model == "tsai":
        return TsaiRadial(kappa=k1)
    return Fisheye(
        k1=0.5 * k1,
        k2=0.5 * k2,
        k3=k3,
        k4=k4,
    )


def random_camera(rng, base, model: str):
    """A camera of a size and a kind, with a random lens, principal point, aspect and
    roll.
    """
    lens = random_lens(rng, model)
    most_deg = min(
        np.degrees(2.0 * lens.widest_rad), 175.0 if model == "fisheye" else 120.0
    )
    return replace(
        base,
        horizontal_fov_deg=float(rng.uniform(0.3, 0.98) * most_deg),
        lens=lens,
        principal_point=tuple(rng.uniform(0.4, 0.6, 2).tolist()),
        pixel_aspect=float(rng.uniform(0.95, 1.05)),
        roll_deg=float(rng.uniform(-10.0, 10.0)),
    )
