"""What a layout may lack of the best over all worlds: limits, and how often they
hold.
"""

import pickle
import re
from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from changes import changed
from scipy.stats import t as student

from geometry.errors import InputError
from placement import growth as growing
from placement import pipeline
from placement.certify import certify, estimate_gap
from placement.compute import Compute
from placement.growth import SIZES, grow
from placement.layout import Layout, load_carlancap_layout
from placement.optimiser import apr
from placement.pipeline import Assembly, assemble, place
from placement.question import AUTO, Question
from placement.sampling import out_of_sample
from placement.sampling.out_of_sample import APART, out_of_sample_layouts
from placement.sampling.tables import sampled_table
from placement.sampling.uncertainty import load_uncertainty
from placement.wishes import Wishes


def test_limits_are_those_of_the_formula():
    bounds = [0.96, 0.97, 0.955, 0.965]
    aprs = [0.95, 0.94, 0.96, 0.93, 0.95]

    found = estimate_gap(bounds, aprs)
    mean_bound = np.mean(bounds)
    quantile_bound = student.ppf(0.975, 3)
    spread_bound = np.std(bounds, ddof=1)
    most = mean_bound + quantile_bound * spread_bound / 2.0
    mean_apr = np.mean(aprs)
    quantile_apr = student.ppf(0.975, 4)
    spread_apr = np.std(aprs, ddof=1)
    least = mean_apr - quantile_apr * spread_apr / np.sqrt(5.0)

    assert found.most.high == pytest.approx(most)
    assert found.least.low == pytest.approx(least)
    assert found.gap == pytest.approx(most - least)
    assert found.bias + found.chance == pytest.approx(found.gap)

    mean_of_bounds = np.mean(bounds)
    mean_of_aprs = np.mean(aprs)
    expected = mean_of_bounds - mean_of_aprs

    assert found.bias == pytest.approx(expected)


def coverage(n_repetitions, *, n_blocks, n_worlds, n_judged=60):
    """Shares of gaps, and of their upper and lower ends, that hold where the optimum is
    known.

    Ten poses, two of which are mounted. In a world each pose sees each of twelve runs
    with a probability of its own, so that the APR of a pair over all worlds has a
    closed form.
    """
    combined = combinations(range(10), 2)
    pairs = np.array(list(combined))
    holds = np.zeros(3)

    def draw_aprs(rng, n, sees, weight):
        """APR of each pair in so many worlds, (n, n_pairs)."""
        uniform = rng.random((n, *sees.shape))
        drawn = uniform < sees
        is_seen = drawn[:, pairs].any(axis=2)
        return is_seen @ weight

    for repetition in range(n_repetitions):
        rng = np.random.default_rng([7, repetition])
        sees = rng.beta(2.0, 1.0, size=(10, 12))
        ones = np.ones(12)
        weight = rng.dirichlet(ones)
        missed = np.prod(1.0 - sees[pairs], axis=1)
        true = (1.0 - missed) @ weight

        blocks = [
            draw_aprs(rng, n_worlds, sees, weight).mean(axis=0) for _ in range(n_blocks)
        ]
        bounds = [block.max() for block in blocks]  # by brute force, hence exact
        best_of_blocks = {int(block.argmax()) for block in blocks}
        pool = sorted(best_of_blocks)
        of_pool = draw_aprs(rng, n_judged, sees, weight)[:, pool]
        compared = of_pool.mean(axis=0)
        highest = compared.argmax()
        best = pool[int(highest)]
        drawn_again = draw_aprs(rng, n_judged, sees, weight)
        judged = drawn_again[:, best]
        aprs = judged.tolist()
        found = estimate_gap(bounds, aprs)
        holds += (
            true.max() - true[best] <= found.gap,
            true.max() <= found.most.high,
            found.least.low <= true[best],
        )

    return holds / n_repetitions


def test_gaps_hold_as_often_as_they_say():
    # 0.95 asked; three standard errors of 200 repetitions are 0.046. APRs near 1 are
    # skewed: the lower end holds less often than the 0.975 of a normal distribution.
    shares = coverage(200, n_blocks=5, n_worlds=4)
    assert (shares >= 0.95 - 0.046).all()


@pytest.fixture(scope="module")
def assembly(setting, candidates):
    """One unit in three worlds, in which messages are lost."""
    uncertainty = replace(load_uncertainty("default"), packet_loss=0.3)
    return Assembly(
        setting=setting,
        candidates=candidates,
        wishes=Wishes(budget_units=1),
        uncertainty=uncertainty,
        n_samples=3,
        compute=Compute(workers=1, seed=4),
    )


@pytest.mark.long
def test_blocks_have_worlds_of_their_own_and_the_best_of_them(assembly):
    n_runs = assembly.setting.axis.n_runs

    found = certify(assembly, n_blocks=3, n_judged=5)

    for number, block in enumerate(found.blocks):
        assert block.first == 3 * number

        table = sampled_table(
            assembly.setting,
            assembly.candidates,
            assembly.uncertainty,
            n_samples=3,
            first=block.first,
            compute=assembly.compute,
        ).table
        one_block = replace(assembly, known_table=table, n_samples=0)
        part = one_block.problem
        n_poses = len(assembly.candidates)
        values = [apr(part, [row]) for row in range(n_poses)]
        of_found = values[block.found[0]]

        assert table.axis.n_runs == 3 * n_runs
        assert block.bound == pytest.approx(max(values))
        assert block.apr == pytest.approx(max(values))
        assert of_found == pytest.approx(max(values))

    best = max(one.estimate.mean for one in found.pool)

    assert found.pool[0].estimate.mean == best


@pytest.mark.long
def test_tasks_that_run_elsewhere_and_in_any_order_give_the_same(assembly, monkeypatch):
    monkeypatch.setattr(out_of_sample, "TOGETHER", 3)
    sent = []

    def run_backwards(function, tasks, *, shared):
        those = list(tasks)
        sent.append((function.__name__, len(those)))
        # As another process would get them
        sent_bytes = pickle.dumps(shared)
        arguments = pickle.loads(sent_bytes)
        for task in reversed(those):
            yield task, function(*arguments, pickle.loads(pickle.dumps(task)))

    here = certify(assembly, n_blocks=2, n_judged=4)
    there = certify(
        assembly,
        n_blocks=2,
        n_judged=4,
        run=run_backwards,
    )

    assert there.blocks == here.blocks
    assert there.gap == here.gap

    for one, other in zip(there.pool, here.pool, strict=True):
        expected = other.avoided_share.tolist()
        assert _same_aprs(one, other)
        assert one.avoided_share.tolist() == expected

    # Four worlds are two tasks.
    assert sent == [
        ("_solve_block", 2),
        ("_look_at_part", 2),
        ("_look_at_part", 2),
    ]


@pytest.mark.long
def test_the_best_is_judged_in_worlds_that_chose_nothing(assembly):
    found = certify(assembly, n_blocks=2, n_judged=4)
    chosen = found.pool[0].layout

    both = out_of_sample_layouts(
        assembly.setting,
        [chosen],
        assembly.uncertainty,
        n_samples=8,
        compute=assembly.compute,
    )[0].apr_by_sample

    assert found.pool[0].apr_by_sample == pytest.approx(both[:4])
    assert found.judged.apr_by_sample == pytest.approx(both[4:])
    assert found.judged.layout.units == chosen.units


def _same_aprs(one, other):
    """Have two judgements the same APR in every world?"""
    aprs = one.apr_by_sample.tolist()
    other_aprs = other.apr_by_sample.tolist()
    return aprs == other_aprs


@pytest.mark.long
def test_what_layouts_avoid_in_fresh_worlds_is_looked_at_once(
    assembly, tmp_path, monkeypatch
):
    compute = replace(assembly.compute, cache_folder=tmp_path)
    cached = replace(assembly, compute=compute)
    first_sensor = assembly.candidates[0].sensor
    units = [one for one in assembly.candidates if one.sensor == first_sensor]
    layouts = [
        Layout(name=f"layout {n}", units=(unit,)) for n, unit in enumerate(units[:2])
    ]
    uncertainty = replace(cached.uncertainty, packet_loss=0.9)
    lossy = replace(cached, uncertainty=uncertainty)

    plain = assembly.in_fresh_worlds(layouts, n_worlds=3)
    first = cached.in_fresh_worlds(layouts, n_worlds=3)
    turned = cached.in_fresh_worlds(layouts[::-1], n_worlds=3)
    other_worlds = cached.in_fresh_worlds(layouts, n_worlds=3, first=7)
    other_losses = lossy.in_fresh_worlds(layouts, n_worlds=3)

    def refuse(*given, **how):
        raise RuntimeError("looked again")

    monkeypatch.setattr(out_of_sample, "look_at_fresh_worlds", refuse)
    again = cached.in_fresh_worlds(layouts, n_worlds=3)

    for one, other, third in zip(plain, first, again, strict=True):
        expected = third.avoided_share.tolist()

        assert _same_aprs(one, other)
        assert _same_aprs(one, third)
        assert one.avoided_share.tolist() == expected
        assert one.layout == third.layout
        assert one.alone == third.alone

    is_same = _same_aprs(other_worlds[0], plain[0])

    assert _same_aprs(turned[1], plain[0])
    assert not is_same
    assert other_losses[0].estimate.mean < plain[0].estimate.mean

    with pytest.raises(RuntimeError):
        assembly.in_fresh_worlds(layouts, n_worlds=3)  # without a folder


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"n_samples": 1}, "samples: got 1; expected a whole number, at least 2"),
        ({"n_samples": 0, "uncertainty": None}, "samples: got 0"),
        ({"wishes": Wishes(target=0.5)}, "a target, failures or a tail"),
    ],
)
def test_what_cannot_be_certified_is_refused(assembly, changes, message):
    with pytest.raises(InputError, match=re.escape(message)):
        certify(replace(assembly, **changes))


def test_one_block_is_refused(assembly):
    with pytest.raises(
        InputError, match="blocks: got 1; expected a whole number, at least 2"
    ):
        certify(assembly, n_blocks=1)


# ---------- how many worlds are enough

TWO_WORKERS = Compute(workers=2, seed=3)
SMALL = Question(
    budget=1,
    cases="CPNC-50",
    approaches="east",
    along_arms="0",
    within="carlancap-12",
    detector="response",
    samples=AUTO,
)


# Quickly: test_rounds_end_when_chance_may_explain_the_rest_or_time_is_up
@pytest.mark.long
def test_as_many_worlds_are_taken_as_twice_as_many_do_not_beat(monkeypatch):
    monkeypatch.setattr(growing, "N_JUDGED", 6)
    monkeypatch.setattr(pipeline, "N_JUDGED", 6)
    compute = Compute(workers=2, seed=3)

    found = grow(SMALL, compute=compute)
    growth = found.growth
    last = None

    assert growth.stopped in ("same", "no better")

    n_rounds = len(growth.rounds)
    expected = [*SIZES[:n_rounds]]
    worlds = [one.worlds for one in growth.rounds]

    assert worlds == expected
    assert growth.rounds[-1].worlds == 2 * growth.taken == 2 * found.assembly.n_samples

    for one in growth.rounds:
        smaller = replace(SMALL, samples=one.worlds)
        plan = assemble(smaller, compute=compute)

        alone = place(plan, asks_worlds=True)  # as if the number had been given
        stage = alone.certificate.stages[0]

        assert one.in_sample == stage.objective

        (again,) = out_of_sample_layouts(
            plan.setting,
            [alone.layout],
            plan.uncertainty,
            n_samples=6,
            first=APART,
            compute=compute,
        )

        assert one.mean == pytest.approx(again.estimate.mean)

        if one.low is not None:
            gain = again.apr_by_sample - last.apr_by_sample
            quantile = student.ppf(0.975, 5)
            spread = gain.std(ddof=1)
            root = np.sqrt(6.0)
            reach = quantile * spread / root
            middle = gain.mean()
            limits = (middle - reach, middle + reach)

            assert (one.low, one.high) == pytest.approx(limits) or np.ptp(gain) == 0.0

        last = again
        if one.worlds == growth.taken:
            assert found.placement.layout.units == alone.layout.units


@pytest.mark.long
def test_poses_of_a_grid_are_the_same_layout_in_every_round(monkeypatch):
    monkeypatch.setattr(growing, "N_JUDGED", 3)
    monkeypatch.setattr(pipeline, "N_JUDGED", 3)
    monkeypatch.setattr(growing, "SIZES", (1, 2))
    real = place
    chosen = []

    def placed(plan, **how):
        """The same rows in each round, of candidates that each round makes anew."""
        found = real(plan, **how)
        layout = pipeline.pick_layout(plan.candidates, [0, 7], "found")
        chosen.append(layout)
        return replace(found, layout=chosen[-1], preferred=None)

    monkeypatch.setattr(growing, "place", placed)
    question = replace(
        SMALL,
        within="",
        heights="6.5",
        yaw_step_deg=120.0,
    )

    compute = Compute(workers=2, seed=3)
    grown = grow(question, compute=compute)
    growth = grown.growth
    first, second = chosen

    assert "/" not in first.units[0].id  # one of the grid
    assert first.units[0].pose is not second.units[0].pose
    assert growth.stopped == "same"
    assert growth.rounds[1].low is None


def scripted(monkeypatch, aprs, *, sizes=(1, 2, 3, 4), seconds=0.0, error=None):
    """Rounds whose layouts differ and have some APRs in fresh worlds; each takes some
    seconds.
    """
    units = load_carlancap_layout().units
    numbers = range(len(aprs))
    rounds = iter(numbers)
    clock = SimpleNamespace(now_s=0.0)
    real = place
    judge = Assembly.in_fresh_worlds

    def placed(plan, **how):
        number = next(rounds)
        if error is not None and number:
            raise error

        found = real(plan, **how)
        clock.now_s += seconds
        unit_there = units[number : number + 1]
        return changed(found, "layout.units", unit_there)

    def judged(self, layouts, **how):
        (one,) = judge(self, layouts, **how | {"n_worlds": 4})
        unit = one.layout.units[0]
        index = units.index(unit)
        judged_one = replace(one, apr_by_sample=aprs[index])
        return [judged_one]

    monkeypatch.setattr(growing, "SIZES", sizes)
    monkeypatch.setattr(growing, "place", placed)
    monkeypatch.setattr(Assembly, "in_fresh_worlds", judged)
    monkeypatch.setattr(growing, "now_s", lambda: clock.now_s)
    return grow(SMALL, compute=TWO_WORKERS)


LOW = [0.5 + 0.01 * 0.5 * n for n in range(4)]
MIDDLE = [0.6 + 0.01 * 0.6 * n for n in range(4)]
HIGH = [0.7 + 0.01 * 0.7 * n for n in range(4)]
# 0 is within t(3) = 3.18 errors of its mean less that of LOW.
MAYBE = [0.45, 0.75, 0.65, 0.55]


@pytest.mark.long
@pytest.mark.parametrize(
    ("aprs", "seconds", "taken", "stopped"),
    [
        ([LOW, MAYBE], 0.0, 1, "no better"),
        ([MIDDLE, LOW], 0.0, 1, "no better"),
        ([LOW, MIDDLE, HIGH, LOW], 0.0, 3, "no better"),
        # Of five times 60 s, 400 s are gone by then.
        ([LOW, MIDDLE, HIGH], 200.0, 2, "time"),
    ],
)
def test_rounds_end_when_chance_may_explain_the_rest_or_time_is_up(
    monkeypatch, aprs, seconds, taken, stopped
):
    found = scripted(monkeypatch, aprs, seconds=seconds)
    last_world = found.placement.problem.sample_index.max()

    assert found.growth.taken == taken
    assert found.growth.stopped == stopped
    assert found.assembly.n_samples == taken
    assert last_world + 1 == taken


@pytest.mark.long
def test_rounds_end_at_the_most_worlds_and_at_the_memory(monkeypatch):
    found = scripted(monkeypatch, [LOW, HIGH], sizes=(1, 2))

    assert found.growth.taken == 2
    assert found.growth.stopped == "most"

    error = InputError("memory", "8", "less")
    found = scripted(monkeypatch, [LOW, HIGH], error=error)

    assert found.growth.taken == 1
    assert found.growth.stopped == "memory"

    with pytest.raises(InputError, match="sites"):
        scripted(monkeypatch, [LOW, HIGH], error=InputError("sites", "8", "less"))


@pytest.mark.parametrize(
    "asked",
    [
        {"target": "0.5", "budget": None},
        {"survive": "1"},
        {"risk": "worst"},
    ],
)
def test_the_number_of_worlds_is_found_out_for_the_highest_mean_alone(asked):
    with pytest.raises(InputError, match="a target, failures or a tail"):
        grow(replace(SMALL, **asked))


def test_a_plan_needs_a_number_of_worlds():
    with pytest.raises(
        InputError, match="samples: got 'auto'; expected a number; auto where"
    ):
        assemble(SMALL)


@pytest.mark.long
def test_a_certificate_shares_no_world_with_how_many_are_enough(monkeypatch):
    seen = []

    def noted(plan, **_):
        seen.append(plan.first_sample)
        return place(plan)

    monkeypatch.setattr(growing, "N_JUDGED", 2)
    monkeypatch.setattr(growing, "place", noted)
    grow(SMALL, first=APART, compute=TWO_WORKERS)

    assert set(seen) == {APART}
