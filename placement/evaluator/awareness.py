"""VRU awareness messages (VAM): in which frames the VUT knows of a VRU that announces itself."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np

from geometry.arrays import BoolArray, FloatArray
from geometry.poses import wrap_deg
from geometry.toml_files import load_toml, take_number
from scenarios.runs import Run

from ..links import Links


@dataclass(frozen=True, slots=True, kw_only=True)
class VamRule:
    """When a device sends: see ``data/vam.toml``.

    Attributes
    ----------
    min_interval_s, max_interval_s : float
        Not sooner after the last message, and not later. [s]
    position_change_m, speed_change_mps, heading_change_deg : float
        What makes a message due. [m], [m/s], [deg]
    """

    min_interval_s: float
    max_interval_s: float
    position_change_m: float
    speed_change_mps: float
    heading_change_deg: float


@cache
def load_vam_rule() -> VamRule:
    """The standard's rule, from ``data/vam.toml``."""
    table = load_toml(files("placement") / "data" / "vam.toml")
    return VamRule(**{key: take_number(table, key, "vam.toml") for key in VamRule.__annotations__})


def sent_frames(run: Run, rule: VamRule) -> BoolArray:
    """Frames of a run in which the VRU's device sends a message; the first is one of them.

    Parameters
    ----------
    run : Run
        How the VRU moves.
    rule : VamRule
        When a message is due.

    Returns
    -------
    is_sent : (n_frames,) bool
        One per frame.
    """
    time, position, yaw = run.time_s, run.vru_position_m, run.vru_yaw_deg
    steps = np.linalg.norm(np.diff(position, axis=0), axis=1)
    speed = np.append(steps / np.diff(time), 0.0) if len(time) > 1 else np.zeros(1)
    if len(time) > 1:
        speed[-1] = speed[-2]
    is_sent = np.zeros(len(time), dtype=bool)
    is_sent[0] = True
    last = 0
    for frame in range(1, len(time)):
        waited_s = time[frame] - time[last] + _ROUNDING_S
        is_due = waited_s >= rule.max_interval_s or (
            waited_s >= rule.min_interval_s
            and (
                np.linalg.norm(position[frame] - position[last]) > rule.position_change_m
                or abs(speed[frame] - speed[last]) > rule.speed_change_mps
                or abs(wrap_deg(yaw[frame] - yaw[last])) > rule.heading_change_deg
            )
        )
        if is_due:
            is_sent[frame] = True
            last = frame
    return is_sent


def known_frames(runs: Sequence[Run], links: Links, rng: np.random.Generator) -> BoolArray:
    """Frames in which the VUT knows of the VRU from its own messages.

    Parameters
    ----------
    runs : sequence of Run
        What is driven.
    links : Links
        Share of equipped VRUs, and of lost messages.
    rng : numpy.random.Generator
        Who is equipped, and what is lost.

    Returns
    -------
    is_known : (n_frames,) bool
        Of all runs, end to end. A message received counts until the next one must come; what the
        device knows of its own position is taken for good enough.
    """
    rule = load_vam_rule()
    luck: dict[int, tuple[float, FloatArray]] = {}
    known = []
    for run in runs:
        key = id(run.encounter)
        if key not in luck:  # one and the same in all weathers
            luck[key] = (float(rng.random()), rng.random(len(run.time_s)))
        equipment, reception = luck[key]
        is_received = reception >= links.packet_loss
        received_s = np.where(sent_frames(run, rule) & is_received, run.time_s, -np.inf)
        age_s = run.time_s - np.maximum.accumulate(received_s)
        is_fresh = age_s <= rule.max_interval_s + _ROUNDING_S
        known.append((equipment < links.vam_rate) & is_fresh)
    return np.concatenate(known)


_ROUNDING_S = 1.0e-6
