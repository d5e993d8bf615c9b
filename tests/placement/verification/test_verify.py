"""Certificates that are true are verified; those that were tampered with are not."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from certified import document_of, two_of_twelve
from hypothesis import HealthCheck, given, settings
from problems import questions

from geometry.errors import InputError
from placement.detection_table import pack_table
from placement.layout import Certificate, Stage
from placement.optimiser import Effort, Solution, solve_placement
from placement.optimiser.problem import Objective
from placement.proof_files import CERTIFICATE_FILE, INSTANCE_FILE, save_certificate
from placement.verification import verify as verify_module
from placement.verification.certificates import load_certificate
from placement.verification.instances import load_problem
from placement.verification.recomputation import stage_names, stage_values
from placement.verification.verify import verify_certificate


def verify(folder, problem, document, **options):
    """What the checker says of what was written to a folder."""
    save_certificate(folder, document, problem)
    stored = load_certificate(folder / CERTIFICATE_FILE)
    return verify_certificate(
        load_problem(folder / INSTANCE_FILE),
        stored,
        options.pop("shown", [unit["unit"] for unit in document["layout"]]),
        **options,
    )


def failed(found):
    """Names of the checks that failed."""
    return {check.name for check in found.checks if not check.passed}


@given(problem=questions())
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_what_the_solver_proves_is_verified(problem, tmp_path):
    try:
        solution = solve_placement(problem)
    except InputError:
        return  # wishes that cannot be met

    found = verify(tmp_path, problem, document_of(problem, solution))

    assert failed(found) == set()

    for proof, stage in zip(found.proofs, solution.certificate.stages, strict=True):
        assert proof.name == stage.name
        assert proof.claims_optimum == proof.is_proven_again == (stage.gap == 0.0)


@given(problem=questions())
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_what_greedy_search_leaves_open_is_verified_as_open(problem, tmp_path):
    try:
        effort = Effort(solver="greedy")
        solution = solve_placement(problem, effort=effort)
    except InputError:
        return

    found = verify(tmp_path, problem, document_of(problem, solution))

    assert failed(found) == set()

    expected = [stage.gap == 0.0 for stage in solution.certificate.stages]
    claims = [proof.claims_optimum for proof in found.proofs]

    assert claims == expected


@pytest.fixture
def problem(frame_axis, rule):
    """The best two of twelve poses."""
    return two_of_twelve(frame_axis, rule)


@pytest.fixture
def document(problem):
    """The certificate of the problem, as written."""
    return document_of(problem, solve_placement(problem))


def test_every_check_is_made_and_every_stage_proven_again(problem, document, tmp_path):
    found = verify(tmp_path, problem, document)

    assert failed(found) == set()

    names = [check.name for check in found.checks]
    distinct = len(set(names))

    assert distinct == len(names)
    assert {
        "instance",
        "model",
        "poses",
        "pose names",
        "layout file",
        "units",
        "money",
        "site capacity",
        "forbidden units",
        "rival sites",
        "floor --target",
    } <= set(names)

    for stage in stage_names(problem):
        assert {stage, f"{stage}: bound", f"{stage}: gap", f"{stage}: reach"} <= set(
            names
        )

    for proof in found.proofs:
        assert proof.is_proven_again


def stage(document, name):
    """A stage of a document."""
    (found,) = (stage for stage in document["stages"] if stage["name"] == name)
    return found


def other_row(document):
    """A pose that hangs where none of the layout does."""
    sites = {unit["row"] // 2 for unit in document["layout"]}
    others = range(4, 12)
    return next(row for row in others if row // 2 not in sites)


def swap_pose(document):
    """Name another row in the layout."""
    document["layout"][0]["row"] = other_row(document)


def swap_pose_and_name(document):
    """Name another row and its pose in the layout."""
    row = other_row(document)
    document["layout"][0] |= {"row": row, "pose": "abcdefghijkl"[row]}


def add_to_objective_and_bound(document):
    """Claim a longer margin, and that it is proven."""
    for key in ("objective", "bound"):
        stage(document, "mean_margin_s")[key] += 0.01


@pytest.mark.parametrize(
    ("change", "checks"),
    [
        (lambda d: stage(d, "apr").update(objective=0.5), {"apr", "apr: gap"}),
        (
            lambda d: stage(d, "mean_margin_s").update(bound=0.0),
            {"mean_margin_s: bound"},
        ),
        (lambda d: stage(d, "cost_eur").update(bound=9999.0), {"cost_eur: bound"}),
        (add_to_objective_and_bound, {"mean_margin_s"}),
        (lambda d: stage(d, "apr").update(gap=0.5), {"apr: gap"}),
        (lambda d: stage(d, "apr").update(is_proven=False), {"apr: gap", "proof"}),
        (lambda d: d["instance"].update(sha256="0" * 64), {"instance"}),
        (lambda d: d["model"].update(fusion="single"), {"model"}),
        (lambda d: d["model"].update(floors=[]), {"model"}),
        (lambda d: d["model"]["stages"].pop(), {"stages"}),
        (lambda d: d["stages"].reverse(), {"stages"}),
        (lambda d: d["presolve"].update(n_poses=[11, 5]), {"presolve"}),
        (swap_pose, {"pose names"}),
        (swap_pose_and_name, set()),
        (lambda d: d["layout"][0].update(row=99), {"poses"}),
        (lambda d: d["layout"][0].update(row=3, pose="d"), {"forbidden units"}),
    ],
)
def test_what_was_changed_is_found(problem, document, tmp_path, change, checks):
    change(document)
    verified = verify(tmp_path, problem, document)
    found = failed(verified)

    assert found
    assert found >= checks


def test_a_layout_beyond_a_limit_is_found(problem, document, tmp_path):
    limits = problem.limits
    numbers = [unit["row"] for unit in document["layout"]]
    rows = np.array(numbers)

    assert len(rows) == 2

    is_used = np.isin(np.arange(12), rows)
    is_free = ~is_used
    forced = is_free & ~limits.is_forbidden & (limits.site_index > 1)
    site_index = np.zeros(12, dtype=np.int64)
    beyond = {
        "units": replace(limits, budget_units=1),
        "money": replace(limits, budget_eur=150.0),
        "site capacity": replace(
            limits,
            site_index=site_index,
            rivals=None,
        ),
        "forced units": replace(limits, is_forced=forced),
        "forced sites": replace(
            limits, is_forced_site=~np.isin(np.arange(6), limits.site_index[rows])
        ),
        "rival sites": replace(limits, rivals=limits.site_index[rows][None, :]),
    }

    for name, others in beyond.items():
        other = replace(problem, limits=others)
        verified = verify(tmp_path, other, document)
        names_failed = failed(verified)

        assert names_failed >= {name, "instance"}


def test_a_floor_that_is_missed_is_found(problem, document, tmp_path):
    floor = replace(problem.floors[0], share=1.0, n_failures=2)
    with_floor = replace(problem, floors=(floor,))
    found = verify(tmp_path, with_floor, document)

    assert "floor --target" in failed(found)


def test_a_changed_table_is_found_even_if_the_hash_was_made_to_fit(
    problem, document, tmp_path
):
    blind = np.zeros((12, problem.table.axis.n_frames), dtype=bool)

    table = pack_table(problem.table.pose_ids, problem.table.axis, blind)
    other = replace(problem, table=table)

    document["instance"]["sha256"] = verify_module.problem_hash(other)
    verified = verify(tmp_path, other, document)
    found = failed(verified)

    assert {"apr", "floor --target"} <= found
    assert "instance" not in found


@pytest.mark.long
@pytest.mark.parametrize("max_sets", [50_000, 45])
def test_a_layout_that_is_not_the_best_is_not_passed_off_as_it(
    problem, tmp_path, max_sets
):
    """All stages recomputed for a worse layout, and claimed to be proven."""
    problem = replace(problem, floors=())
    presolve = solve_placement(problem).presolve
    best = {
        stage.name: stage.objective
        for stage in solve_placement(problem).certificate.stages
    }
    n_worse = 0
    for rows in combinations(range(4, 12), 2):
        sets = np.array([rows])
        if rows[0] // 2 == rows[1] // 2:
            continue
        values = {
            name: float(stage_values(problem, Objective(name), sets)[0])
            for name in best
        }
        if values == pytest.approx(best):
            continue
        stages = tuple(
            Stage(
                name=name,
                objective=value,
                bound=value,
                gap=0.0,
                seconds=0.0,
            )
            for name, value in values.items()
        )
        lie = Solution(
            pose_index=rows,
            certificate=Certificate(stages=stages, solver="an oracle"),
            presolve=presolve,
        )
        found = verify(
            tmp_path,
            problem,
            document_of(problem, lie),
            max_sets=max_sets,
        )
        n_worse += 1

        assert failed(found)
        assert all(name.endswith(": others") for name in failed(found))

        disproved = {
            proof.name for proof in found.proofs if proof.reason == "disproved"
        }
        if max_sets > 45:
            expected = {f"{name}: others" for name in disproved}
            assert expected == failed(found)

    assert n_worse > 10


def test_what_cannot_be_proven_again_rests_on_the_solver(problem, document, tmp_path):
    document["solver"] = "an oracle"
    found = verify(tmp_path, problem, document, max_sets=0)

    assert found.passed
    for check in found.checks:
        assert not check.name.endswith(": others")

    for proof in found.proofs:
        assert proof.claims_optimum
        assert (proof.reason == "an oracle") == (not proof.is_proven_again)

    are_all_proven = all(proof.is_proven_again for proof in found.proofs)

    assert not are_all_proven


def test_the_layout_file_must_show_the_same_units(problem, document, tmp_path):
    units = [unit["unit"] for unit in document["layout"]]
    renamed = [{**unit, "id": "X"} for unit in units]
    for shown in (units[:1], units[::-1], renamed, []):
        assert failed(verify(tmp_path, problem, document, shown=shown)) == {
            "layout file"
        }


def test_units_on_one_site_are_not_shown_on_two(problem, tmp_path):
    site_index = np.zeros(12, dtype=np.int64)
    rivals = np.zeros((0, 2), dtype=np.int64)
    one_site = replace(
        problem,
        limits=replace(
            problem.limits,
            site_index=site_index,
            site_capacity=[2],
            site_cost_eur=np.zeros(1),
            is_forced_site=np.zeros(1, dtype=bool),
            rivals=rivals,
        ),
    )
    document = document_of(one_site, solve_placement(one_site))
    for sites, expected in (
        (("east", "east"), set()),
        (("east", "west"), {"layout file"}),
    ):
        for unit, site in zip(document["layout"], sites, strict=True):
            unit["unit"]["site"] = site
        verified = verify(tmp_path, one_site, document)
        assert failed(verified) == expected
