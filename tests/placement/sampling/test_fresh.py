"""Layouts judged in worlds that did not choose them."""

from dataclasses import replace

import numpy as np
import pytest
from sampled_worlds import first_world, table_of_world
from tiny_worlds import table_of

from geometry.errors import InputError
from placement.compute import Compute
from placement.evaluator import evaluate_layout
from placement.layout import Layout
from placement.sampling.out_of_sample import (
    N_DRAWS,
    SampledApr,
    join_worlds,
    judge_layouts,
    look_at_fresh_worlds,
    out_of_sample_layouts,
)
from placement.sampling.tables import build_sample_tables
from placement.sampling.uncertainty import Blinding, LatencyJitter, Uncertainty
from placement.sampling.worlds import draw_samples


def out_of_sample(setting, layout, uncertainty, **options):
    """One layout judged."""
    (judged,) = out_of_sample_layouts(
        setting,
        [layout],
        uncertainty,
        **options,
    )
    return judged


LOSSY = Uncertainty(packet_loss=0.6, latency=LatencyJitter(mean_s=0.4, sd_s=0.3))


@pytest.fixture(scope="module")
def layouts(candidates, look):
    """Two units, and each alone; both of one name."""
    corner = look(
        "corner",
        [-115.4, 8.85, 6.8],
        yaw_deg=-120.0,
        pitch_deg=-25.0,
        site_id="corner-ne",
    )
    mast = candidates[2]
    return [
        Layout(name="both", units=(corner, mast)),
        Layout(name="one", units=(corner,)),
        Layout(name="other", units=(replace(mast, id=corner.id),)),
    ]


@pytest.fixture(scope="module")
def judged(setting, layouts):
    """The layouts in twelve worlds in which messages are lost and late."""
    return out_of_sample_layouts(setting, layouts, LOSSY, n_samples=12)


def _avoided_by_hand(table, axis, deadlines_s):
    """The rule by hand: three frames in a row of any unit, 25 ms, the deadline."""
    seen = table.detected(slice(None)).any(axis=0)
    avoided = []
    for run in range(axis.n_runs):
        frames = axis.frames_of(run)
        times = axis.time_s[frames]
        row = seen[frames]
        confirmed = [
            t for k, t in enumerate(times) if k >= 2 and row[k - 2 : k + 1].all()
        ]
        first_s = min(confirmed, default=np.inf)
        avoided.append(first_s + 0.025 <= deadlines_s[run] + 1e-9)

    return np.array(avoided)


def test_without_uncertainty_every_world_is_the_plan(setting, layouts):
    axis = setting.axis
    plan = table_of(setting, layouts[0].units)
    avoided = _avoided_by_hand(plan, axis, axis.last_brake_time_s)

    result = out_of_sample(
        setting,
        layouts[0],
        Uncertainty(),
        n_samples=2,
    )

    expected = np.full(2, axis.weight @ avoided)

    assert result.apr_by_sample == pytest.approx(expected)
    assert result.avoided_share.tolist() == avoided.astype(float).tolist()
    assert avoided.any()


@pytest.mark.long
def test_a_layout_is_worth_in_a_world_what_its_table_says(setting, layouts, judged):
    axis = setting.axis
    samples = draw_samples(
        setting,
        layouts[0].units,
        LOSSY,
        n_samples=12,
        seed=0,
        purpose="judge",
    )

    for index, sample in enumerate(samples):
        deadlines_s = axis.last_brake_time_s - sample.extra_latency_s

        draws = [
            _avoided_by_hand(table, axis, deadlines_s)
            for _, table in build_sample_tables([sample], n_draws=N_DRAWS)
        ]

        assert len(draws) == N_DRAWS

        apr = axis.weight @ np.mean(draws, axis=0)

        assert judged[0].apr_by_sample[index] == pytest.approx(apr)


def test_worlds_to_judge_in_are_not_those_to_choose_in(setting, layouts):
    def drawn(purpose):
        samples = draw_samples(
            setting,
            layouts[0].units,
            LOSSY,
            n_samples=3,
            seed=0,
            purpose=purpose,
        )
        tables = set()
        latencies = set()
        for sample in samples:
            tables.add(table_of_world(sample).packed.tobytes())
            latencies.add(sample.extra_latency_s.tobytes())

        return tables, latencies

    for chosen_in, judged_in in zip(drawn("choose"), drawn("judge"), strict=True):
        assert not chosen_in & judged_in


def test_layouts_are_judged_in_the_same_worlds_alone_or_together(
    setting, layouts, judged
):
    two_workers = Compute(workers=2)

    for layout, together in zip(layouts, judged, strict=True):
        alone = out_of_sample(
            setting,
            layout,
            LOSSY,
            n_samples=12,
            compute=two_workers,
        )
        expected = together.apr_by_sample.tolist()

        assert alone.apr_by_sample.tolist() == expected
        assert alone.layout is layout

    both, one, other = judged
    better = np.maximum(one.apr_by_sample, other.apr_by_sample)

    # More units never do harm, world by world; two units of one name are not confused.
    assert (both.apr_by_sample >= better).all()
    assert not np.array_equal(one.avoided_share, other.avoided_share)


def test_worlds_looked_at_in_parts_are_the_same_worlds(setting, layouts, judged):
    parts = [
        look_at_fresh_worlds(setting, layouts, LOSSY, n_worlds=n_worlds, first=first)
        for first, n_worlds in (
            (0, 5),
            (5, 4),
            (9, 3),
        )
    ]
    together = judge_layouts(
        setting,
        layouts,
        LOSSY,
        join_worlds(parts),
    )

    for item, same in zip(together, judged, strict=True):
        expected = same.apr_by_sample.tolist()
        assert item.apr_by_sample.tolist() == expected
        assert item.avoided_share == pytest.approx(same.avoided_share)


def _with_units(layout, **changes):
    """The layout with all its units changed."""
    units = [replace(unit, **changes) for unit in layout.units]
    return replace(layout, units=tuple(units))


def test_a_name_is_not_luck(setting, layouts, judged):
    units = [replace(unit, id=f"U{n}") for n, unit in enumerate(layouts[0].units)]
    renamed = replace(layouts[0], units=tuple(units))

    again = out_of_sample(setting, renamed, LOSSY, n_samples=12)
    expected = judged[0].apr_by_sample.tolist()

    assert again.apr_by_sample.tolist() == expected


def test_numbers_of_a_judgement_belong_together(setting, judged):
    for item in judged:
        assert setting.axis.weight @ item.avoided_share == pytest.approx(
            item.estimate.mean
        )
        assert item.worst == item.apr_by_sample.min() == item.cvar(0.0)
        assert item.worst <= item.cvar(0.25) <= item.cvar(1.0) + 1e-12
        assert item.cvar(1.0) == pytest.approx(item.estimate.mean)
        assert item.estimate.low <= item.estimate.mean <= item.estimate.high

    assert len({item.estimate.mean for item in judged}) > 1
    assert max(np.ptp(item.apr_by_sample) for item in judged) > 0.0
    assert repr(judged[0]).startswith("SampledApr('both': 0.")


def test_alone_a_unit_confirms_no_more_than_all_together(setting, layouts, judged):
    both, one, other = judged
    better = np.maximum(one.apr_by_sample, other.apr_by_sample)

    single = out_of_sample(
        setting,
        layouts[0],
        LOSSY,
        n_samples=12,
        fusion="single",
    )

    assert (single.apr_by_sample <= both.apr_by_sample + 1e-12).all()
    assert (single.apr_by_sample >= better).all()
    assert single.estimate.mean < both.estimate.mean


def test_a_units_own_latency_counts(setting, layouts):
    slow = _with_units(layouts[1], latency_s=60.0)
    result = out_of_sample(setting, slow, Uncertainty(), n_samples=1)

    assert result.estimate.mean == 0.0


@pytest.mark.long
@pytest.mark.parametrize("dirty_share", [0.0, 0.5])
def test_cars_that_see_are_judged_without_units_too(setting, layouts, dirty_share):
    seeing = replace(setting, cars=1.0)
    uncertainty = replace(LOSSY, blinding=Blinding(dirty_share=dirty_share))

    slow = _with_units(layouts[1], latency_s=60.0)

    quick, late = out_of_sample_layouts(
        seeing,
        [layouts[1], slow],
        uncertainty,
        n_samples=3,
    )

    assert late.alone == pytest.approx(late.estimate.mean)
    assert quick.alone == pytest.approx(late.alone)
    assert quick.alone <= quick.estimate.mean


def test_cars_that_do_not_see_avoid_nothing_without_units(setting, layouts):
    assert out_of_sample(setting, layouts[1], LOSSY, n_samples=1).alone == 0.0


def test_progress_counts_worlds(setting, layouts):
    calls = []

    def told(*call):
        calls.append(call)

    compute = Compute(progress=told)
    out_of_sample(
        setting,
        layouts[1],
        Uncertainty(),
        n_samples=2,
        compute=compute,
    )
    expected = [("out of sample", done, 2) for done in (0, 1, 2)]

    assert calls == expected


def test_a_judgement_must_fit_its_runs(setting, layouts):
    avoided_share = np.ones(setting.axis.n_runs + 1)
    with pytest.raises(InputError, match="avoided_share"):
        SampledApr(
            layout=layouts[0],
            axis=setting.axis,
            apr_by_sample=np.ones(3),
            avoided_share=avoided_share,
        )


def test_the_evaluator_takes_a_sampled_world_as_it_is(setting, layouts, default):
    """Full perception of the units as they hang, past what stands in the street."""
    units = layouts[1].units
    sample = first_world(setting, units, default, purpose="judge")
    mounted = replace(layouts[1], units=sample.candidates)
    lossless = replace(sample.setting, radio=setting.radio)

    by_pixels = evaluate_layout(mounted, lossless).units[units[0].id].detected
    (by_table,) = table_of_world(replace(sample, setting=lossless)).detected([0])

    assert (by_pixels == by_table).mean() >= 0.95
    assert by_table.any()
