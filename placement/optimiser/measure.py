"""How much is avoided: an expectation over runs, or over the worst share of sampled worlds."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geometry.arrays import BoolArray, FloatArray, IntArray, freeze
from geometry.errors import InputError, Unquoted


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measure:
    """Accident prevention ratio of what is avoided.

    Attributes
    ----------
    weight : (n_runs,) float
        Weights of the runs that can be avoided; all runs together weigh 1, or what counts does.
    sample_index : (n_runs,) int
        Sampled world of each run; all 0 where nothing was sampled.
    sample_weight : (n_samples,) float
        What all runs of each world weigh together, also those that nothing avoids.
    tail : float
        Share of the worlds that counts, the worst ones: 1 is the expectation, up to
        1 / n_samples the worst world alone.

    Notes
    -----
    With a tail, this is the conditional value at risk of Rockafellar and Uryasev (2000): the mean
    over the worst share, in which one world may count in part.
    """

    weight: FloatArray
    sample_index: IntArray
    sample_weight: FloatArray
    tail: float = 1.0

    @property
    def is_mean(self) -> bool:
        """Whether this is a plain weighted sum of runs."""
        return self.tail == 1.0

    def of(self, is_avoided: BoolArray) -> FloatArray:
        """Ratio of each set of avoided runs: (..., n_runs) -> (...,)."""
        if self.is_mean:
            share: FloatArray = is_avoided @ self.weight
            return share
        n_samples = len(self.sample_weight)
        by_sample = np.zeros((*is_avoided.shape[:-1], n_samples))
        for sample in range(n_samples):
            mine = self.sample_index == sample
            by_sample[..., sample] = is_avoided[..., mine] @ self.weight[mine]
        ratio = by_sample / self.sample_weight
        order = np.argsort(ratio, axis=-1, kind="stable")
        worst_first = np.take_along_axis(ratio, order, axis=-1)
        ends = np.minimum(np.cumsum(self.sample_weight[order], axis=-1), self.tail)
        parts = np.diff(ends, axis=-1, prepend=0.0)
        result: FloatArray = (parts * worst_first).sum(axis=-1) / self.tail
        return result

    @property
    def limit(self) -> float:
        """Ratio where all runs that can be avoided are."""
        return float(self.of(np.ones(len(self.weight), dtype=bool)))

    def of_runs(self, runs: IntArray) -> "Measure":
        """The same where all other runs are out of reach."""
        return Measure(
            weight=self.weight[runs],
            sample_index=self.sample_index[runs],
            sample_weight=self.sample_weight,
            tail=self.tail,
        )


def build_measure(
    weight: FloatArray, sample_index: ArrayLike | None = None, *, tail: float = 1.0
) -> Measure:
    """Measure of runs with weights.

    Parameters
    ----------
    weight : (n_runs,) float
        Of the runs.
    sample_index : (n_runs,) int, optional
        Sampled world of each run, 0, 1, ..; by default there is one.
    tail : float
        See :class:`Measure`.

    Raises
    ------
    InputError
        The tail is not in 0 < tail <= 1, or the samples are not numbered 0, 1, .. with weight.
    """
    if not 0.0 < tail <= 1.0:
        raise InputError("tail", tail, "a share of the samples, 0 < share <= 1")
    samples = np.zeros(len(weight)) if sample_index is None else np.array(sample_index)
    samples = samples.astype(np.int64)
    if samples.shape != np.shape(weight) or (samples.size and samples.min() < 0):
        raise InputError("sample_index", Unquoted("other samples"), "one, from 0, for each run")
    total = np.bincount(samples, weights=weight)
    if not (total > 0.0).all():
        raise InputError("sample_index", Unquoted("a sample without weight"), "runs in each sample")
    return Measure(
        weight=freeze(np.array(weight, dtype=np.float64)),
        sample_index=freeze(samples),
        sample_weight=freeze(total / total.sum()),
        tail=float(tail),
    )
