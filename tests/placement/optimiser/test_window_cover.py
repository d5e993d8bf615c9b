from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from synthetic_instances import SyntheticSize, build_synthetic_instance

from placement.optimiser.bounds import Coverage, Supply, first_seen_values, prove, timely_windows
from placement.optimiser.window_cover import find_window_cover
from scenarios.aeb import AebRule

RULE = AebRule(deceleration_mps2=7.72, latency_s=0.025, n_confirmations=3, frame_rate_hz=10.0)
SIZE = SyntheticSize(
    n_sites=6,
    heights_m=(5.0,),
    n_yaws=4,
    pitches_deg=(-8.0,),
    zooms_deg=(90.0,),
    n_runs=12,
    n_frames=360,
)


@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.booleans())
def test_cover_is_the_best_on_the_windows_themselves(
    seed: int, max_units: int, counts_runs: bool
) -> None:
    instance = build_synthetic_instance(SIZE, seed=seed)
    windows = timely_windows(instance.axis, RULE)
    last = np.arange(windows.margin_s.shape[1]) < windows.n_windows[:, None]
    worth = last.astype(np.float64) if counts_runs else windows.margin_s
    supply = Supply(
        max_units=max_units,
        site_index=instance.site_index,
        site_capacity=np.ones_like(instance.site_capacity),
    )
    sets = np.array(list(combinations(range(len(instance.packed)), max_units)))
    unions = np.bitwise_or.reduce(instance.packed[sets[supply.allows_each(sets)]], axis=1)
    totals = first_seen_values(unions, windows, worth, frames=slice(None)).sum(axis=1)
    best = float(totals.max())
    cover = find_window_cover(instance.packed, windows, worth, supply)
    assert supply.allows(cover.poses)
    assert cover.value == pytest.approx(best, rel=1e-6)
    assert best * (1.0 - 1e-6) <= cover.limit <= best * (1.0 + 1e-5) + 1e-9
    asked = Coverage(
        values=first_seen_values(instance.packed, windows, worth, frames=cover.frames),
        supply=supply,
    )
    ceiling = float(asked.values.max(axis=0).sum(dtype=np.float64))
    proven = min(prove(asked, cover.multipliers).limit, ceiling)
    assert cover.root_limit == pytest.approx(proven, rel=1e-5)


def test_gap_is_honest_when_time_is_up() -> None:
    instance = build_synthetic_instance(SIZE, seed=1)
    windows = timely_windows(instance.axis, RULE)
    supply = Supply(
        max_units=3, site_index=instance.site_index, site_capacity=instance.site_capacity
    )
    steps: list[str] = []
    short = find_window_cover(
        instance.packed,
        windows,
        windows.margin_s,
        supply,
        time_limit_s=0.0,
        workers=2,
        on_step=steps.append,
    )
    exact = find_window_cover(instance.packed, windows, windows.margin_s, supply)
    assert steps[:2] == ["values", "bound"]
    assert short.value <= exact.value * (1.0 + 1e-9)
    assert exact.value <= short.limit
    assert short.gap >= exact.gap
