import numpy as np
import pytest

from scenarios.exposure import weight_per_run


def test_every_run_counts_the_same_and_all_sum_to_one(runs):
    weight = weight_per_run(runs)
    assert weight.shape == (len(runs),)
    assert len(np.unique(weight)) == 1
    assert weight.sum() == pytest.approx(1.0, abs=1e-12)
