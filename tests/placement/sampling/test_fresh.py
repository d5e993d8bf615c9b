"""Layouts judged in worlds that did not choose them."""

from dataclasses import replace

import numpy as np
import pytest
from refusal_words import refused_saying
from sampled_worlds import first_world, table_of_world

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
from placement.visibility import build_detection_table


def out_of_sample(setting, layout, uncertainty, **options):
    """One layout judged."""
    (judged,) = out_of_sample_layouts(setting, [layout], uncertainty, **options)
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


def _avoided_by_hand(seen, axis, deadlines_s):
    """The rule by hand: three frames in a row, 25 ms, the deadline."""
    avoided = []
    for run in range(axis.n_runs):
        frames = axis.frames_of(run)
        times = axis.time_s[frames]
        row = seen[frames]
        confirmed = [
            t for k, t in enumerate(times) if k >= 2 and row[k - 2 : k + 1].all()
        ]
        avoided.append(
            bool(confirmed) and confirmed[0] + 0.025 <= deadlines_s[run] + 1e-9
        )

    return np.array(avoided)


def test_without_uncertainty_every_world_is_the_plan(setting, layouts):
    axis = setting.axis
    units = layouts[0].units

    plan = build_detection_table(
        setting.scene, units, setting.runs, axis, detector=setting.table_detector
    )
    seen = plan.detected(slice(None)).any(axis=0)
    avoided = _avoided_by_hand(seen, axis, axis.last_brake_time_s)
    result = out_of_sample(setting, layouts[0], Uncertainty(), n_samples=2)

    assert result.apr_by_sample == pytest.approx(np.full(2, axis.weight @ avoided))
    assert result.avoided_share.tolist() == avoided.astype(float).tolist()
    assert avoided.any()


@pytest.mark.long
def test_a_layout_is_worth_in_a_world_what_its_table_says(setting, layouts, judged):
    axis = setting.axis
    both = layouts[0]

    samples = draw_samples(
        setting, both.units, LOSSY, n_samples=12, seed=0, purpose="judge"
    )

    for index, sample in enumerate(samples):
        deadlines_s = axis.last_brake_time_s - sample.extra_latency_s
        draws = [
            _avoided_by_hand(table.detected(slice(None)).any(axis=0), axis, deadlines_s)
            for _, table in build_sample_tables([sample], n_draws=N_DRAWS)
        ]

        assert len(draws) == N_DRAWS

        avoided = np.mean(draws, axis=0)

        assert judged[0].apr_by_sample[index] == pytest.approx(axis.weight @ avoided)


def test_worlds_to_judge_in_are_not_those_to_choose_in(setting, layouts):
    chosen_in, judged_in = (
        [
            (table_of_world(s).packed.tobytes(), s.extra_latency_s.tobytes())
            for s in draw_samples(
                setting, layouts[0].units, LOSSY, n_samples=3, seed=0, purpose=purpose
            )
        ]
        for purpose in ("choose", "judge")
    )
    for part in (0, 1):
        assert not {w[part] for w in chosen_in} & {w[part] for w in judged_in}


def test_layouts_are_judged_in_the_same_worlds_alone_or_together(
    setting, layouts, judged
):
    for layout, together in zip(layouts, judged, strict=True):
        alone = out_of_sample(
            setting, layout, LOSSY, n_samples=12, compute=Compute(workers=2)
        )
        assert alone.apr_by_sample.tolist() == together.apr_by_sample.tolist()
        assert alone.layout is layout

    both, one, other = judged

    # More units never do harm, world by world; two units of one name are not confused.
    assert (
        both.apr_by_sample >= np.maximum(one.apr_by_sample, other.apr_by_sample)
    ).all()
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
    together = judge_layouts(setting, layouts, LOSSY, join_worlds(parts))

    for item, same in zip(together, judged, strict=True):
        assert item.apr_by_sample.tolist() == same.apr_by_sample.tolist()
        assert item.avoided_share == pytest.approx(same.avoided_share)


def test_a_name_is_not_luck(setting, layouts, judged):
    renamed = replace(
        layouts[0],
        units=tuple(replace(u, id=f"U{n}") for n, u in enumerate(layouts[0].units)),
    )
    again = out_of_sample(setting, renamed, LOSSY, n_samples=12)

    assert again.apr_by_sample.tolist() == judged[0].apr_by_sample.tolist()


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
    single = out_of_sample(setting, layouts[0], LOSSY, n_samples=12, fusion="single")
    one, other = judged[1:]

    assert (single.apr_by_sample <= judged[0].apr_by_sample + 1e-12).all()
    assert (
        single.apr_by_sample >= np.maximum(one.apr_by_sample, other.apr_by_sample)
    ).all()
    assert single.estimate.mean < judged[0].estimate.mean


def test_a_units_own_latency_counts(setting, layouts):
    slow = replace(
        layouts[1], units=tuple(replace(u, latency_s=60.0) for u in layouts[1].units)
    )
    result = out_of_sample(setting, slow, Uncertainty(), n_samples=1)

    assert result.estimate.mean == 0.0


@pytest.mark.long
def test_cars_that_see_are_judged_without_units_too(setting, layouts):
    seeing = replace(setting, cars=1.0)
    dirty = replace(LOSSY, blinding=Blinding(dirty_share=0.5))
    slow = replace(
        layouts[1], units=tuple(replace(u, latency_s=60.0) for u in layouts[1].units)
    )

    for uncertainty in (LOSSY, dirty):
        judged = out_of_sample_layouts(
            seeing, [layouts[1], slow], uncertainty, n_samples=3
        )
        assert [item.alone for item in judged] == [
            pytest.approx(judged[1].estimate.mean)
        ] * 2
        assert judged[0].alone <= judged[0].estimate.mean

    assert out_of_sample(setting, layouts[1], LOSSY, n_samples=1).alone == 0.0


def test_progress_counts_worlds(setting, layouts):
    calls = []
    out_of_sample(
        setting,
        layouts[1],
        Uncertainty(),
        n_samples=2,
        compute=Compute(progress=lambda *call: calls.append(call)),
    )

    assert calls == [("out of sample", done, 2) for done in (0, 1, 2)]


def test_a_judgement_must_fit_its_runs(setting, layouts):
    with refused_saying("avoided_share"):
        SampledApr(
            layout=layouts[0],
            axis=setting.axis,
            apr_by_sample=np.ones(3),
            avoided_share=np.ones(setting.axis.n_runs + 1),
        )


def test_the_evaluator_takes_a_sampled_world_as_it_is(setting, layouts, default):
    """Full perception of the units as they hang, past what stands in the street."""
    units = layouts[1].units
    sample = first_world(setting, units, default, purpose="judge")
    mounted = replace(layouts[1], units=sample.candidates)

    evaluation = evaluate_layout(mounted, replace(sample.setting, radio=setting.radio))
    lossless = replace(sample.setting, radio=setting.radio)
    by_table = table_of_world(replace(sample, setting=lossless)).detected([0])[0]
    agreement = (evaluation.units[units[0].id].detected == by_table).mean()

    assert agreement >= 0.95
    assert by_table.any()
