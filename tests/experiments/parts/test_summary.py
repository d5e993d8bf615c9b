"""Records of evaluations and comparisons, and of what was driven."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from json_files import as_json
from made_verdicts import avoiding, made_evaluation
from tiny_worlds import axis_of_runs

from experiments.jobs.evaluation import build_comparison_result, build_evaluation_result
from experiments.parts.result import disagreeing_runs
from experiments.results.drives import DrivesRecord, build_drives_record, versions
from experiments.results.record import build_evaluation_record
from geometry.study_scene import load_study_scene
from placement.detection_table import DetectionTable
from placement.detectors import load_detector
from placement.optimiser import Limits, PlacementProblem
from placement.setting import Radio
from scenarios.aeb import load_aeb_rule
from scenarios.runs import FrameAxis, Refusal

RULE = load_aeb_rule()
N_RUNS = 49  # 49 times 1/49 is not 1 in floating point, when added one by one


@pytest.fixture
def axis():
    """Runs of one frame each, of equal weight, in two cases."""
    return FrameAxis(
        run_ids=tuple(f"{'AB'[run % 2]}/north/{run}" for run in range(N_RUNS)),
        cases=tuple("AB"[run % 2] for run in range(N_RUNS)),
        approaches=("north",) * N_RUNS,
        weathers=("day",) * N_RUNS,
        vut_speed_kmh=np.full(N_RUNS, 20.0),
        weight=np.full(N_RUNS, 1.0 / N_RUNS),
        last_brake_time_s=np.full(N_RUNS, -0.1),
        run_start=np.arange(N_RUNS + 1),
        time_s=np.zeros(N_RUNS),
    )


@pytest.fixture
def evaluation_of(axis):
    """Builds an evaluation of a layout whose one unit avoids the first n runs."""

    def build(n_avoided, name="mine"):
        avoided = np.arange(N_RUNS) < n_avoided
        verdict = avoiding(axis, avoided, detected=avoided)
        return made_evaluation(axis, verdict, name=name, ids=["A"])

    return build


def setting_of(axis, *refusals):
    """A setting of runs on foot, and what could not be laid."""
    return SimpleNamespace(
        scene=load_study_scene(),
        axis=axis,
        runs=[
            SimpleNamespace(
                case=SimpleNamespace(
                    name=name,
                    title="adult crosses",
                    vru=SimpleNamespace(class_name="pedestrian"),
                ),
                approach=approach,
                road_user="on foot",
            )
            for name, approach in zip(axis.cases, axis.approaches, strict=True)
        ],
        refusals=refusals,
        detector=load_detector(),
        vut_sensors=("camera", "lidar"),
        cars=0.0,
        radio=Radio(packet_loss=0.25, vam_rate=0.5),
        rule=RULE,
    )


@pytest.fixture
def setting(axis):
    return setting_of(axis)


def test_all_runs_avoided_is_exactly_one_and_none_is_zero(evaluation_of):
    for n_avoided, ratio in (
        (N_RUNS, 1.0),
        (0, 0.0),
    ):
        summary = as_json(build_evaluation_record(evaluation_of(n_avoided), RULE))
        ratios = {
            "all": ratio,
            "by_case": {"A": ratio, "B": ratio},
            "by_position": {"0": ratio},
            "mean_impact_speed_kmh": None,
        }
        assert summary == {
            "vut": ratios,
            "rsu_all": ratios,
            "vut_and_rsus": ratios,
            "units": {"A": ratios},
            "apr_without_worst_unit": 0.0,  # there is but one
            **dict.fromkeys(
                ("apr_without_worst_site", "vam", "all_sources", "headline")
            ),
        }


def test_speeds_at_contact_stand_beside_the_ratio(evaluation_of, axis):
    plain_one = evaluation_of(N_RUNS - 2)
    left_kmh = np.where(plain_one.rsu_all.is_avoided, 0.0, 20.0)
    left_kmh[-1] = 8.0
    verdict = replace(plain_one.rsu_all, impact_speed_kmh=left_kmh)
    evaluation = replace(plain_one, rsu_all=verdict)
    found = build_evaluation_record(evaluation, RULE).rsu_all

    assert found.mean_impact_speed_kmh == pytest.approx(28.0 / N_RUNS)


def test_ratios_are_shares_of_the_runs(setting, evaluation_of):
    summary = as_json(build_evaluation_result(setting, evaluation_of(7)))
    assert summary["apr"] == pytest.approx(7 / N_RUNS, abs=1e-15)
    assert summary["evaluation"]["rsu_all"]["by_case"] == {
        "A": pytest.approx(4 / 25, abs=1e-15),
        "B": pytest.approx(3 / 24, abs=1e-15),
    }


def test_an_evaluation_and_a_comparison_have_the_same_head(setting, evaluation_of):
    single = as_json(build_evaluation_result(setting, evaluation_of(3)))
    both = as_json(
        build_comparison_result(setting, evaluation_of(3), [evaluation_of(5, "other")])
    )

    assert set(both) - set(single) == {
        "compared",
        "differences",
        "baselines",
        "sampled",
    }
    assert set(single) <= set(both)
    assert single.pop("schema") == "place-rsus/evaluation/2"
    assert both.pop("schema") == "place-rsus/comparison/2"

    of_one = single.pop("road_users")
    of_both = both.pop("road_users")
    groups = (of_one["groups"][0], of_both["groups"][0])
    parties = [[party["name"] for party in group["parties"]] for group in groups]

    assert parties == [
        ["mine", "VUT alone"],
        ["mine", "other", "VUT alone"],
    ]
    assert {key: both[key] for key in single} == single


def test_comparison_lists_the_runs_that_differ(setting, evaluation_of):
    more = evaluation_of(5, "more")
    less = evaluation_of(3, "less")
    differing = ["B/north/3", "A/north/4"]
    better = as_json(build_comparison_result(setting, more, [less]))
    worse = as_json(build_comparison_result(setting, less, [more]))
    (other,) = better["compared"]
    (one,) = worse["compared"]

    assert other["runs_gained"] == differing
    assert other["runs_lost"] == []
    assert one["runs_gained"] == []
    assert one["runs_lost"] == differing
    assert other["evaluation"] == as_json(build_evaluation_record(less, RULE))
    assert better["name"] == "more"
    assert other["name"] == "less"


def test_versions_name_what_the_numbers_depend_on():
    found = versions()
    assert {
        "place-rsus",
        "python",
        "cvxpy",
        "highspy",
        "numpy",
        "scipy",
        "trimesh",
    } < set(found)
    assert sum(name.startswith("rays: ") for name in found) == 1


def test_drives_are_cases_weathers_perception_and_what_is_not_driven(axis):
    refusal = Refusal(
        case=SimpleNamespace(name="C"),
        approach="north",
        speeds_kmh=(20.0, 25.0),
        reason="no room",
    )
    axis = replace(axis, weathers=("night", "day") + ("night",) * (N_RUNS - 2))
    setting = setting_of(axis, refusal)

    assert as_json(build_drives_record(setting)) == {
        "cases": ["A", "B"],
        "weathers": ["night", "day"],
        "detector": "geometric",
        "vut_sensors": ["camera", "lidar"],
        "cars": 0.0,
        "packet_loss": 0.25,
        "vam_rate": 0.5,
        "track_memory_s": None,
        "not_driven": [
            {
                "case": "C",
                "approach": "north",
                "position": "0",
                "speeds_kmh": [20.0, 25.0],
                "reason": "no room",
                "is_possible": True,
            }
        ],
        # Two speeds in two weathers.
        "possible_runs": N_RUNS + 4,
        "driven": [
            f"{N_RUNS} of {N_RUNS + 4} possible runs are simulated. The main reason"
            " why others are not: no room. Not simulated: C anywhere.",
            "4 runs: no room (C from the north).",
        ],
        "without_effect": [
            "Night has no effect on cameras here: the geometric detector does not"
            " model light. --detector response does."
        ],
    }


def test_fog_and_other_detectors_are_not_said_to_change_nothing(axis):
    def said(detector="geometric", *weathers):
        changed = replace(axis, weathers=weathers + ("day",) * (N_RUNS - len(weathers)))
        setting = setting_of(changed)
        setting.detector = load_detector(detector)
        return build_drives_record(setting).without_effect

    assert said("geometric", "fog") == said("response", "night") == said() == ()

    (text,) = said("geometric", "night", "rain", "fog")
    assert text.startswith("Night and rain have no effect on cameras here:")


def test_a_result_says_what_was_driven(evaluation_of, axis):
    setting = setting_of(axis)
    drives = build_drives_record(setting)
    result = build_comparison_result(
        setting, evaluation_of(3), [evaluation_of(5, "other")]
    )

    for name in DrivesRecord.__struct_fields__:
        assert getattr(result, name) == getattr(drives, name)
    assert drives.not_driven == ()


def test_disagreement_is_judged_under_the_fusion_asked_for(evaluation_of, rule):
    axis = axis_of_runs([0, 4], [-0.7, -0.6, -0.5, -0.4], -0.2)
    # Two units that confirm together only.
    frames = np.array(
        [
            [True, True, False, False],
            [False, False, True, True],
        ]
    )
    table = DetectionTable(
        pose_ids=("A", "B"),
        axis=axis,
        packed=np.packbits(frames, axis=1, bitorder="little"),
    )

    missed = avoiding(axis, [False])
    avoided = avoiding(axis, [True])
    evaluation = replace(
        evaluation_of(0),
        axis=axis,
        units={"A": missed, "B": missed},
        rsu_all=avoided,
    )
    for fusion in ("any", "single"):
        problem = PlacementProblem(
            table=table,
            limits=Limits(
                site_index=np.array([0, 1]),
                site_capacity=np.array([1, 1]),
                budget_units=2,
            ),
            fusion=fusion,
            rule=rule,
        )
        placement = SimpleNamespace(
            problem=problem,
            pose_index=(0, 1),
            nominal=problem,
            nominal_index=(0, 1),
        )
        assert disagreeing_runs(placement, evaluation).tolist() == [False]

        other = replace(evaluation, rsu_all=missed, units={"A": avoided})
        assert disagreeing_runs(placement, other).tolist() == [True]
