"""Candidate poses of a grid at the sites of a scene."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused_with
from tiny_worlds import unit_at

from geometry.catalogue import load_cameras
from geometry.lidar import load_lidars
from geometry.scene import Scene, Site
from placement.candidates import (
    CandidateGrid,
    build_candidates,
    is_turn_useless,
    load_candidate_grid,
)

CAMERAS = tuple(load_cameras().values())[:2]
LIDARS = load_lidars()
SECTOR = LIDARS["carla-ncap-lidar"]
RING = LIDARS["ouster-os1-128"]


def _scene(*height_ranges_m):
    """A scene with sites of these ranges of height. [m]"""
    return Scene(
        name="junction",
        vertices_m=np.zeros((0, 3)),
        triangles=np.zeros((0, 3)),
        triangle_instance=np.zeros(0),
        instances=(),
        sites=tuple(
            Site(
                id=f"pole-{index}",
                position_m=[10.0 * index, -5.0, 0.5],
                kind="lamp post",
                height_range_m=height_range,
                capacity_units=2,
            )
            for index, height_range in enumerate(height_ranges_m)
        ),
        outline_m=np.zeros((0, 2)),
        lanes=(),
        crs="EPSG:25832",
    )


def _grid(**changes):
    """A grid of two heights and three pitches."""
    fields = {
        "heights_m": np.array([6.0, 8.0]),
        "yaw_step_deg": 30.0,
        "pitches_deg": np.array([-30.0, -20.0, -10.0]),
        "sensors": CAMERAS,
    }
    return CandidateGrid(**{**fields, **changes})


def test_every_combination_is_there_once():
    three_poles = _scene([5, 9], [5, 9], [5, 9])
    candidates = build_candidates(three_poles, _grid())
    keys = {
        (
            c.site_id,
            c.pose.position_m[2],
            c.pose.yaw_deg,
            c.pose.pitch_deg,
            c.sensor.name,
        )
        for c in candidates
    }
    ids = {c.id for c in candidates}

    assert len(candidates) == len(keys) == 3 * 2 * 12 * 3 * len(CAMERAS)
    assert len(ids) == len(candidates)


@given(st.sampled_from([1, 2, 3, 4, 6, 8, 9, 12, 24, 36, 48, 72]))
def test_yaws_go_all_around_once(n_yaws):
    step_deg = 360.0 / n_yaws

    candidates = build_candidates(
        _scene([5, 9]),
        _grid(
            heights_m=[6.0],
            pitches_deg=[-20.0],
            sensors=CAMERAS[:1],
            yaw_step_deg=step_deg,
        ),
    )
    yaws_given = [c.pose.yaw_deg for c in candidates]
    yaws = np.sort(yaws_given)

    assert len(yaws) == n_yaws
    assert (yaws > -180.0).all()
    assert (yaws <= 180.0).all()

    closed = np.append(yaws, yaws[0] + 360.0)
    around = np.diff(closed)
    has_exponent = any("e-" in c.id.split("/")[2] for c in candidates)

    assert around == pytest.approx(step_deg, abs=1e-9)
    assert 180.0 in yaws
    assert (0.0 in yaws) == (n_yaws % 2 == 0)
    assert [float(c.id.split("/")[2]) for c in candidates] == pytest.approx(
        yaws, rel=1e-5
    )
    assert not has_exponent


def test_the_default_grid_looks_every_15_degrees_at_three_heights_and_pitches():
    grid = load_candidate_grid()
    names = [sensor.name for sensor in grid.sensors]

    assert len(grid.heights_m) == 3
    assert grid.n_yaws == 24
    assert len(grid.pitches_deg) == 3
    assert names == ["carla-ncap-rgb"]


def test_what_scans_all_round_hangs_level_and_is_not_turned():
    scene = _scene([5, 9])

    grid = _grid(sensors=(*CAMERAS, SECTOR))
    mixed = build_candidates(scene, grid)
    others = [c.id for c in mixed]

    assert len(others) == 2 * 3 * 12 * 3
    assert others[0] == f"pole-0/6m/-150/-30/{CAMERAS[0].name}"

    found = [
        c.id for c in build_candidates(scene, _grid(sensors=(*CAMERAS, SECTOR, RING)))
    ]
    rings = [name for name in found if name not in others]
    expected = [f"pole-0/{height}m/0/0/{RING.name}" for height in (6, 8)]

    assert rings == expected
    assert [
        name for name in found if name in others
    ] == others  # unchanged, in their order


def test_a_tilted_ring_is_turned():
    grid = _grid(sensors=(RING,), ring_pitches_deg=[-20.0, 0.0, 10.0])
    directions = grid.directions_deg(RING)
    distinct = len(set(directions))
    pitches = {pitch for _, pitch in directions}
    is_useless = is_turn_useless(CAMERAS[0], pitch_deg=0.0)

    assert directions[0] == (0.0, 0.0)
    assert distinct == len(directions) == 1 + 12 * 2
    assert pitches == {-20.0, 0.0, 10.0}
    assert [is_turn_useless(RING, pitch_deg=pitch) for pitch in (0.0, -20.0)] == [
        True,
        False,
    ]
    assert not is_turn_useless(SECTOR, pitch_deg=0.0)
    assert not is_useless


def test_the_default_grid_hangs_rings_level():
    pitches_deg = load_candidate_grid().ring_pitches_deg.tolist()
    assert pitches_deg == [0.0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"heights_m": []}, "heights_m: got none; expected at least one"),
        ({"heights_m": [5.0, 0.0]}, "heights_m: got [5.0, 0.0]; expected metres, > 0"),
        ({"heights_m": 5.0}, "heights_m: got shape (); expected shape (-1,)"),
        (
            {"pitches_deg": [-91.0]},
            "pitches_deg: got [-91.0]; expected -90 .. 90 degrees",
        ),
        (
            {"yaw_step_deg": 361.0},
            "yaw_step_deg: got 361.0; expected 0 < degrees <= 360",
        ),
        ({"yaw_step_deg": np.nan}, "yaw_step_deg: got nan; expected finite numbers"),
        (
            {"yaw_step_deg": 50.0},
            "yaw_step_deg: got 50.0; expected degrees that divide 360 evenly",
        ),
        ({"sensors": ()}, "sensors: got none; expected at least one"),
    ],
)
def test_a_grid_says_what_is_wrong(change, message):
    with refused_with(message):
        _grid(**change)


def test_heights_are_brought_into_the_sites_range_and_count_once():
    four_poles = _scene([5, 9], [7, 9], [6.5, 7.5], [4, 5])
    candidates = build_candidates(four_poles, _grid())
    heights = {
        f"pole-{index}": sorted(
            # The foot of the pole is at 0.5 m.
            {
                float(c.pose.position_m[2] - 0.5)
                for c in candidates
                if c.site_id == f"pole-{index}"
            }
        )
        for index in range(4)
    }
    ids = {c.id for c in candidates}

    assert heights == {
        "pole-0": [6.0, 8.0],
        "pole-1": [7.0, 8.0],
        "pole-2": [6.5, 7.5],
        "pole-3": [5.0],
    }
    assert len(ids) == len(candidates)


def test_candidates_stand_above_their_site():
    two_poles = _scene([5, 9], [5, 9])
    for candidate in build_candidates(two_poles, _grid()):
        number = candidate.site_id.removeprefix("pole-")
        index = int(number)
        place_m = candidate.pose.position_m[:2]

        assert place_m.tolist() == [10.0 * index, -5.0]


def _extra(pose_id):
    """A pose that is named by itself."""
    return unit_at(pose_id, sensor=CAMERAS[0])


def test_poses_by_name_come_last():
    extra = (_extra("RSU0"), _extra("RSU1"))

    one_pole = _scene([5, 9])
    candidates = build_candidates(one_pole, _grid(), extra=extra)

    assert candidates[-2:] == extra
    assert repr(candidates[-1]) == "CandidatePose('RSU1')"


def test_a_repeated_id_is_named():
    with refused_with("candidates: got 'RSU0'; expected every id once"):
        build_candidates(
            _scene([5, 9]), _grid(), extra=(_extra("RSU0"), _extra("RSU0"))
        )


def test_a_scene_without_sites_is_refused():
    with refused_with("junction: sites: got none; expected at least one mount site"):
        build_candidates(_scene(), _grid())
