"""Random numbers that stay the same whatever else is drawn: one generator for each thing."""

import zlib
from dataclasses import dataclass

import numpy as np

from geometry.errors import InputError

from ..candidates import CandidatePose
from ..compute import check_whole

PURPOSES = ("choose", "judge")
"""Worlds to choose a layout in, and worlds to judge it in, share no random number."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Luck:
    """Where the random numbers of one sampled world come from.

    Attributes
    ----------
    seed : int
        The user's.
    purpose : {"choose", "judge"}
        What the world is for.
    index : int
        Number of the world.
    """

    seed: int
    purpose: str
    index: int

    def __post_init__(self) -> None:
        check_whole("--seed", self.seed, least=0)
        if self.purpose not in PURPOSES:
            raise InputError("purpose", self.purpose, "one of " + ", ".join(PURPOSES))

    def rng(self, *key: object) -> np.random.Generator:
        """Generator of one thing of this world; its draws do not depend on any other thing."""
        thing = zlib.crc32(repr(key).encode())
        return np.random.default_rng(
            [self.seed, PURPOSES.index(self.purpose) + 1, self.index, thing]
        )


def mount_key(candidate: CandidatePose) -> tuple[object, ...]:
    """Equal for poses of one physical mount: one site, or one point where there is none."""
    if candidate.site_id:
        return ("site", candidate.site_id)
    return ("point", *candidate.pose.position_m[:2].tolist())


def pose_key(candidate: CandidatePose) -> tuple[object, ...]:
    """Equal for units that are meant to see the same, whatever they are called."""
    pose = candidate.pose
    zoom_deg = getattr(candidate.sensor, "horizontal_fov_deg", None)
    angles_deg = (pose.yaw_deg, pose.pitch_deg, zoom_deg)
    return (*pose.position_m.tolist(), *angles_deg, candidate.sensor.name)
