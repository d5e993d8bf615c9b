"""From detected frames to a verdict for every run: messages, confirmation, braking, contact."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.arrays import BoolArray, FloatArray
from geometry.errors import InputError, Unquoted
from geometry.files import load_toml, take_number
from geometry.poses import wrap_deg
from scenarios.aeb import AebRule, has_contact
from scenarios.runs import FrameAxis, Run, find_onsets

from ..compute import DEFAULT_COMPUTE, Compute
from ..evaluation import Evaluation, Verdict, earliest_arrival_s
from ..layout import Layout
from ..setting import Radio, Setting
from .surroundings import draw_index
from .watch import STAGE, VUT_KEY, UnitKey, build_rng, unit_key, watch

# ---------- verdicts: confirmation, braking, contact


Party = tuple[BoolArray, float]
"""(n_frames,): detected frames that reach the VUT; how long it takes until it knows [s]."""


class Judge:
    """Verdicts on the same runs; remembers which onsets of braking end in contact."""

    def __init__(self, runs: Sequence[Run], axis: FrameAxis, rule: AebRule) -> None:
        self.axis, self._runs, self._rule = axis, runs, rule
        # By encounter, which runs that differ by weather alone share, then by onset.
        self._has_contact: dict[int, dict[float, bool]] = {id(run.encounter): {} for run in runs}

    def verdict(self, parties: Sequence[Party]) -> Verdict:
        """Verdict on parties that are fused; see :meth:`verdicts`."""
        return self.verdicts([parties])[0]

    def verdicts(self, fused: Sequence[Sequence[Party]]) -> list[Verdict]:
        """Verdicts on groups of parties: in each frame any one of a group may be the detector.

        Braking begins when the last message has arrived that confirms the track which is alive at
        the last moment; whether it avoids is asked of the bodies, not of the last moment.
        """
        arrivals = [earliest_arrival_s(parties, self.axis) for parties in fused]
        onsets = [find_onsets(arrival, self.axis, rule=self._rule) for arrival in arrivals]
        touches = self._touches(np.array([each.onset_s for each in onsets]))
        return [
            Verdict(
                detected=np.isfinite(arrival),
                confirmation_time_s=each.confirmation_s,
                onset_time_s=each.onset_s,
                is_avoided=~touching,
            )
            for arrival, each, touching in zip(arrivals, onsets, touches, strict=True)
        ]

    def _touches(self, onset_s: FloatArray) -> BoolArray:
        """Whether the bodies touch if braking begins then, (n, n_runs) for the same of onsets."""
        touches = np.empty(onset_s.shape, dtype=bool)
        for index, run in enumerate(self._runs):
            asked, known = onset_s[:, index].tolist(), self._has_contact[id(run.encounter)]
            new = [each for each in dict.fromkeys(asked) if each not in known]
            if new:
                found = has_contact(run.encounter, new, self._rule)
                known.update(zip(new, found.tolist(), strict=True))
            touches[:, index] = [known[each] for each in asked]
        return touches


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Seen:
    """What each party of a layout detects; `vam`: what road users tell of themselves, if any do."""

    layout: Layout
    units: Mapping[str, Party]
    vut: Party
    vam: Party | None = None


def judge_layouts(judge: Judge, seen: Sequence[Seen]) -> list[Evaluation]:
    """Evaluations of layouts by what their units and the VUT detect."""
    fused: list[dict[tuple[str, ...], list[Party]]] = []
    for one in seen:
        rsus, vam = [*one.units.values()], [] if one.vam is None else [one.vam]
        fused.append(
            {("unit", name): [party] for name, party in one.units.items()}
            | {("vut",): [one.vut], ("rsu_all",): rsus, ("vut_and_rsus",): [*rsus, one.vut]}
            | ({("vam",): vam, ("all_sources",): [*rsus, one.vut, *vam]} if vam else {})
        )
    verdicts = iter(judge.verdicts([parties for groups in fused for parties in groups.values()]))
    evaluations = []
    for one, groups in zip(seen, fused, strict=True):
        found = {key: next(verdicts) for key in groups}
        evaluations.append(
            Evaluation(
                layout=one.layout,
                axis=judge.axis,
                vut=found["vut",],
                units={name: found["unit", name] for name in one.units},
                rsu_all=found["rsu_all",],
                vut_and_rsus=found["vut_and_rsus",],
                others={name: found[name,] for name in ("vam", "all_sources") if one.vam},
            )
        )
    return evaluations


# ---------- VRU awareness messages (VAM)


@dataclass(frozen=True, slots=True, kw_only=True)
class VamRule:
    """When a device sends: see ``data/vam.toml``."""

    # min_interval_s, max_interval_s: not sooner after the last message, and not later. [s]
    min_interval_s: float
    max_interval_s: float
    # position_change_m, speed_change_mps, heading_change_deg: what makes a message due. [m], [m/s],
    # [deg]
    position_change_m: float
    speed_change_mps: float
    heading_change_deg: float


@cache
def load_vam_rule() -> VamRule:
    """The standard's rule, from ``data/vam.toml``."""
    table = load_toml(files("placement") / "data" / "vam.toml")
    return VamRule(**{key: take_number(table, key, "vam.toml") for key in VamRule.__annotations__})


def sent_frames(run: Run, rule: VamRule) -> BoolArray:
    """Frames of a run in which the VRU's device sends, (n_frames,) bool; the first is one."""
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


def known_frames(runs: Sequence[Run], links: Radio, rng: np.random.Generator) -> BoolArray:
    """Frames of all runs, end to end, in which the VUT knows of the VRU from its own messages.

    The random numbers say who is equipped and which messages are lost. A message that was received
    counts until the next one must come. The device is taken to know its own position exactly.
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


# ---------- evaluation of layouts


def evaluate_layout(
    layout: Layout, setting: Setting, *, compute: Compute = DEFAULT_COMPUTE
) -> Evaluation:
    """Evaluate one layout; see :func:`evaluate_layouts`."""
    return evaluate_layouts([layout], setting, compute=compute)[0]


def evaluate_layouts(
    layouts: Sequence[Layout], setting: Setting, *, compute: Compute = DEFAULT_COMPUTE
) -> list[Evaluation]:
    """Verdicts of layouts by rendering every frame, detecting, confirming and braking.

    Parameters
    ----------
    layouts : sequence of Layout
        Units at the same pose in several layouts are rendered once.
    setting : Setting
        Scene, runs, braking rule, detector, radio.
    compute : Compute
        What is left to chance are misses, lost messages, who carries a device. A unit's luck
        depends on its pose, not on the layout that it is part of. For the progress see
        :func:`placement.evaluator.watch.watch`.

    Returns
    -------
    evaluations : list of Evaluation
        One per layout.

    Raises
    ------
    InputError
        The setting's axis does not belong to its runs.
    """
    _check(setting)
    compute.progress(STAGE, 0, 0)
    units = {unit_key(unit): unit for layout in layouts for unit in layout.units}
    with threadpool_limits(1):  # one BLAS thread per worker: idle ones spin
        detected = watch(setting, units, compute=compute)
    judge = Judge(setting.runs, setting.axis, setting.rule)
    vam = None
    if setting.radio.vam_rate > 0.0:
        rng = build_rng(compute.seed, "vam")
        vam = (known_frames(setting.runs, setting.radio, rng), setting.rule.latency_s)
    return judge_layouts(
        judge,
        [
            Seen(
                layout=layout,
                units=_arriving(layout, setting, detected, compute.seed),
                vut=(detected[VUT_KEY], setting.rule.latency_s),
                vam=vam,
            )
            for layout in layouts
        ],
    )


def _check(setting: Setting) -> None:
    runs, axis = setting.runs, setting.axis
    if tuple(run.id for run in runs) != axis.run_ids or not np.array_equal(
        np.concatenate([run.time_s for run in runs]), axis.time_s
    ):
        raise InputError("axis", Unquoted("frames of other runs"), "the frame axis of these runs")


def _arriving(
    layout: Layout, setting: Setting, detected: Mapping[UnitKey, BoolArray], seed: int
) -> dict[str, Party]:
    """What the VUT hears of each unit, by its id."""
    draws, frame_draw = np.unique(draw_index(setting.runs), return_inverse=True)
    units = {}
    for unit in layout.units:
        luck = build_rng(seed, unit_key(unit), "cpm").random(len(draws))
        arrives = (luck >= setting.radio.packet_loss)[frame_draw]
        units[unit.id] = (detected[unit_key(unit)] & arrives, unit.latency(setting.rule))
    return units
