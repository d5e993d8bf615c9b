"""Verdicts and evaluations made by hand."""

from dataclasses import replace

import numpy as np

from geometry.poses import Pose
from placement.candidates import CandidatePose
from placement.evaluation import Evaluation, Verdict
from placement.layout import Layout, load_carlancap_layout
from scenarios.confirmation import is_in_time, live_confirmation_time_s


def made_verdict(axis, onset_s, *, is_avoided=None, detected=None):
    """Braking sets in at these times; without `is_avoided`, what is in time is."""
    onset = np.array(onset_s, dtype=float)
    if is_avoided is None:
        is_avoided = onset <= axis.last_brake_time_s
    if detected is None:
        detected = np.zeros(axis.n_frames, dtype=bool)
    return Verdict(
        detected=detected,
        confirmation_time_s=onset,
        onset_time_s=onset,
        is_avoided=np.asarray(is_avoided, dtype=bool),
    )


def live_verdict(axis, detected, rule):
    """What the rule makes of detections, run by run as on the road."""
    confirmation_s = np.empty(axis.n_runs)
    # The first confirmation of all, in time or not.
    endless = replace(rule, track_memory_s=np.inf)
    for index in range(axis.n_runs):
        frames = axis.frames_of(index)
        confirmation_s[index] = live_confirmation_time_s(
            detected[frames], axis.time_s[frames], until_s=np.inf, rule=endless
        )
    return Verdict(
        detected=detected,
        confirmation_time_s=confirmation_s,
        onset_time_s=confirmation_s + rule.latency_s,
        is_avoided=is_in_time(
            confirmation_s, axis.last_brake_time_s, latency_s=rule.latency_s
        ),
    )


def avoiding(axis, is_avoided, detected=None):
    """Avoids these runs, a second before the impact."""
    avoided = np.array(is_avoided, dtype=bool)
    onset_s = np.where(avoided, -1.0, np.inf)
    return made_verdict(axis, onset_s, is_avoided=avoided, detected=detected)


def made_evaluation(axis, together, *, name="mine", ids=("RSU0",), **others):
    """Of cameras on one pole, all with the same verdict; of `others` another one."""
    sensor = load_carlancap_layout().units[0].sensor
    pose = Pose(position_m=[0.0, 0.0, 6.0], yaw_deg=0.0)
    units = tuple(
        CandidatePose(
            id=unit,
            site_id="",
            pose=pose,
            sensor=sensor,
        )
        for unit in ids
    )
    verdicts = {"vut": together, "rsu_all": together, "vut_and_rsus": together}
    return Evaluation(
        layout=Layout(name=name, units=units),
        axis=axis,
        units=dict.fromkeys(ids, together),
        **(verdicts | others),
    )
