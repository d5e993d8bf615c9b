"""Machine code for the steps to come, made in a second process while the first ones are done.

A small made-up question is answered while runs are laid and the detection table is
built.
"""

import logging
from collections.abc import Sequence

import numpy as np

from geometry.kernels import is_compiled

from .candidates import CandidatePose, build_candidates, load_candidate_grid
from .compute import Compute
from .detection_table import DetectionTable, pack_table
from .evaluator import evaluate_layouts
from .layout import Layout
from .optimiser import Effort
from .optimiser.front import front_below
from .pipeline import Assembly, place
from .question import Question
from .setting import Setting, build_setting
from .wishes import Wishes

_QUESTION = Question(cases="CPNC-50,CBNA,CBLA", along_arms="0", speeds="50")
_N_POSES = 300
_SEEN_SHARE = 0.15  # of the runs, by each pose: so little that three of them leave some
_SEED = 1
_TIME_LIMIT_S = 20.0


def compile_ahead() -> None:
    """Compile what optimiser and evaluator need, unless that was done before on this machine."""
    from .evaluator.pixels import see
    from .optimiser.walk_kernels import grow

    if is_compiled(grow) and is_compiled(see):
        return
    # The first process reports that it compiles.
    logging.getLogger("geometry.kernels").setLevel(logging.ERROR)
    compute = Compute(workers=1)
    setting = build_setting(_QUESTION, compute=compute)
    every = build_candidates(setting.scene, load_candidate_grid())
    candidates = every[:: max(1, len(every) // _N_POSES)]
    if not is_compiled(grow):
        _optimise(setting, candidates)
    if not is_compiled(see):  # the first process may have come to it meanwhile
        layout = Layout(name="made up", units=tuple(candidates[:1]))
        evaluate_layouts([layout], setting, compute=compute)


def _optimise(setting: Setting, candidates: Sequence[CandidatePose]) -> None:
    """All that the main job asks the optimiser for, on made-up detections."""
    table = _table_of_chance(tuple(candidate.id for candidate in candidates), setting)
    effort = Effort(time_limit_s=_TIME_LIMIT_S)
    assembly = Assembly(
        setting=setting,
        candidates=candidates,
        wishes=Wishes(budget_units=3),
        effort=effort,
        known_table=table,
    )
    found = place(assembly)
    reduced = assembly.presolved
    front_below(
        found.problem,
        found.pose_index,
        found.certificate,
        effort=effort,
        reduced=reduced,
    )


def _table_of_chance(pose_ids: tuple[str, ...], setting: Setting) -> DetectionTable:
    """Detections such that each pose sees a part of some runs from some frame on."""
    rng = np.random.default_rng(_SEED)
    axis = setting.axis
    detected = np.zeros((len(pose_ids), axis.n_frames), dtype=bool)
    for row in detected:
        for run in np.flatnonzero(rng.random(axis.n_runs) < _SEEN_SHARE):
            begin, end = axis.run_start[run : run + 2]
            row[rng.integers(begin, end) : end] = True
    return pack_table(pose_ids, axis, detected)
