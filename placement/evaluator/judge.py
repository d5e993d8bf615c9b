"""From detected frames to verdicts: messages, confirmation, braking, contact."""

from collections.abc import Sequence

import numpy as np

from geometry.arrays import BoolArray
from scenarios.aeb import AebRule, has_contact
from scenarios.runs import FrameAxis, Run, onset_times_s

from ..evaluation import Verdict, earliest_arrival_s


class Judge:
    """Verdicts on the same runs; remembers which onsets of braking end in contact."""

    def __init__(self, runs: Sequence[Run], axis: FrameAxis, rule: AebRule) -> None:
        self.axis, self._runs, self._rule = axis, runs, rule
        self._has_contact: dict[tuple[int, float], bool] = {}

    def verdict(self, parties: Sequence[tuple[BoolArray, float]]) -> Verdict:
        """Verdict on parties that are fused: in each frame any of them may be the detector.

        Parameters
        ----------
        parties : sequence of pair of (n_frames,) bool and float
            Detected frames that reach the VUT, and how long that takes. [s]

        Returns
        -------
        verdict : Verdict
            Braking sets in when the last message that confirms has arrived.
        """
        arrival = earliest_arrival_s(parties, self.axis)
        confirmation, onset = onset_times_s(
            arrival, self.axis, n_confirmations=self._rule.n_confirmations
        )
        return Verdict(
            detected=np.isfinite(arrival),
            confirmation_time_s=confirmation,
            onset_time_s=onset,
            is_avoided=np.array(
                [not self._touches(index, onset_s) for index, onset_s in enumerate(onset.tolist())]
            ),
        )

    def _touches(self, run_index: int, onset_s: float) -> bool:
        key = (run_index, onset_s)
        if key not in self._has_contact:
            self._has_contact[key] = has_contact(
                self._runs[run_index].encounter, onset_s, self._rule
            )
        return self._has_contact[key]
