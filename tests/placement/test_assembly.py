"""What a question becomes: candidates, limits and prices."""

from dataclasses import replace

import pytest
from refusals import refused_with
from small_results import assemble_without_runs

from geometry.errors import InputError
from geometry.study_scene import load_study_scene
from placement import candidates as poses
from placement import layout as layouts
from placement.candidates import build_candidates, build_grid, load_candidate_grid
from placement.layout import Layout
from placement.question import Question
from placement.wishes import load_prices, read_wishes

# Of the sites of the study's junction.
KINDS = ("lamp post", "traffic light", "mast arm")


@pytest.fixture
def coarse(monkeypatch):
    """Makes the default grid coarse."""
    grid = replace(
        load_candidate_grid(),
        heights_m=[6.0],
        yaw_step_deg=90.0,
        pitches_deg=[-20.0],
    )
    monkeypatch.setattr(poses, "load_candidate_grid", lambda *, is_coarse=False: grid)


@pytest.fixture
def study(coarse, monkeypatch):
    """In place of the study's layout: one camera at its junction, off the grid."""
    scene = load_study_scene()
    one = build_candidates(scene, poses.load_candidate_grid())[0]
    turned = replace(one.pose, yaw_deg=one.pose.yaw_deg + 1.0)
    layout = Layout(
        name="study",
        units=(replace(one, id="mine", pose=turned),),
        scene_name=scene.name,
    )
    monkeypatch.setattr(layouts, "load_carlancap_layout", lambda: layout)
    return layout


def ids(question, scene):
    """Names of a question's candidates."""
    return {
        candidate.id for candidate in assemble_without_runs(question, scene).candidates
    }


def test_the_studys_poses_are_candidates_at_its_own_junction(study):
    scene = load_study_scene()
    question = Question(budget=1)
    elsewhere = replace(scene, name="elsewhere")

    assert ids(question, scene) - ids(question, elsewhere) == {"mine"}


def test_a_layout_is_kept_or_chosen_within_by_name(study):
    scene = load_study_scene()
    plan = assemble_without_runs(Question(budget=1, keep="carlancap-12"), scene)

    assert plan.existing is study
    assert plan.wishes.existing == ("mine",)
    assert plan.wishes.budget_units == 2
    assert ids(Question(budget=1, within="carlancap-12"), scene) == {"mine"}

    with pytest.raises(
        InputError, match="budget: got 2; expected at most 1: candidates and"
    ):
        assemble_without_runs(Question(budget=2, within="carlancap-12"), scene)

    with pytest.raises(
        InputError, match=r"^keep: got 'none\.json'; expected carlancap-12, or"
    ):
        assemble_without_runs(Question(budget=1, keep="none.json"), scene)


def test_heights_yaws_and_pitches_are_those_asked_for(coarse):
    question = Question(
        budget=1,
        heights="4, 7.5",
        yaw_step_deg=180.0,
        pitches="-40,-10,0",
    )

    grid = build_grid(question)

    assert grid.heights_m.tolist() == [4.0, 7.5]
    assert grid.pitches_deg.tolist() == [-40.0, -10.0, 0.0]
    assert grid.n_yaws == 2
    assert grid.sensors == load_candidate_grid().sensors


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"heights": "4,low"},
            "heights: got 'low'; expected metres with commas between, 0.5 to",
        ),
        (
            {"heights": "0"},
            "heights: got '0'; expected metres with commas between, 0.5 to 50",
        ),
        (
            {"heights": ","},
            "heights: got ','; expected names with commas between, each once",
        ),
        (
            {"pitches": "nan"},
            "pitches: got 'nan'; expected degrees with commas between, -90 to",
        ),
        (
            {"yaw_step_deg": 50.0},
            "yaw_step_deg: got 50.0; expected degrees that divide 360 evenly",
        ),
    ],
)
def test_a_grid_that_cannot_be_is_refused(options, message):
    with pytest.raises(InputError) as caught:
        build_grid(Question(budget=1, **options))
    assert str(caught.value).startswith(message)


def test_every_sensor_asked_for_is_tried_at_every_pose(coarse):
    def poses(sensors):
        found = {}
        # Where the study has no poses.
        scene = replace(load_study_scene(), name="elsewhere")
        plan = assemble_without_runs(Question(budget=1, sensors=sensors), scene)
        for pose in plan.candidates:
            found.setdefault(pose.sensor.name, set()).add(_place(pose))

        return found

    names = ["carla-ncap-lidar", "carla-ncap-rgb"]
    default, lidars, both = map(
        poses, ("", names[0], "carla-ncap-rgb, carla-ncap-lidar")
    )

    expected = [
        names[1:],
        names[:1],
        names,
    ]

    assert [sorted(found) for found in (default, lidars, both)] == expected
    assert both == default | lidars
    with pytest.raises(
        InputError, match=r"^sensors: got .radar.; expected one of .*carla-ncap-"
    ):
        poses("radar")


def _place(candidate):
    """Position and yaw of a candidate."""
    return (*candidate.pose.position_m.tolist(), candidate.pose.yaw_deg)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0", (0, "unit")),
        ("unit", (1, "unit")),
        ("site", (1, "site")),
        ("2 sites", (2, "site")),
    ],
)
def test_what_may_fail_is_a_number_of_units_or_of_sites(text, expected):
    wishes = read_wishes(Question(budget=1, survive=text))
    assert (wishes.survive, wishes.failing) == expected


@pytest.mark.parametrize("text", ["", "-1", "1.5", "poles", "2 sites 3"])
def test_other_words_for_what_may_fail_are_refused(text):
    with refused_with(
        f"survive: got {text!r}; expected how many units may fail, at least 0, or"
        " unit, site, such as '2 sites'"
    ):
        read_wishes(Question(budget=1, survive=text))


def test_prices_of_sites_are_assumed_only_where_money_is_asked_about(coarse):
    scene = load_study_scene()

    def cost_eur(question):
        plan = assemble_without_runs(question, scene)
        limits = plan.limits
        names = {
            one.site_id: index
            for one, index in zip(plan.candidates, limits.site_index, strict=True)
        }
        return {site.kind: limits.site_cost_eur[names[site.id]] for site in scene.sites}

    prices = load_prices()
    assumed = {kind: sum(prices.of_kind(kind).values()) for kind in KINDS}

    assert set(cost_eur(Question(budget=1)).values()) == {0.0}
    assert set(cost_eur(Question(budget=1, target="0.9")).values()) == {0.0}
    assert cost_eur(Question(budget_cost=9000.0)) == assumed
    assert cost_eur(Question(target="0.9", least="cost")) == assumed
    assert set(cost_eur(Question(budget_cost=9000.0, site_cost_eur=5.0)).values()) == {
        5.0
    }
