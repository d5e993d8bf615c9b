"""Which unit of a refined layout is which of the old one, and how far it moved."""

from dataclasses import replace

import pytest
from tiny_worlds import unit_at

from geometry.catalogue import pick_sensor
from geometry.sensors import with_fov
from placement.layout import Layout
from placement.refinement import Move, pair_units, rename

CAMERA = pick_sensor("carla-ncap-rgb", "test")


def _unit(name, east=0.0, height=5.0, yaw=0.0, pitch=-15.0, sensor=CAMERA):
    """A unit of the camera at a place."""
    return unit_at(
        name,
        [east, 0.0, height],
        yaw_deg=yaw,
        pitch_deg=pitch,
        site_id="pole",
        sensor=sensor,
    )


def test_units_are_paired_by_place_and_nearest_direction():
    before = [
        _unit("U1", yaw=170.0),
        _unit("U2", yaw=0.0),
        _unit("U3", east=9.0),
    ]
    after = [
        _unit("a", yaw=30.0),
        _unit("b", yaw=-175.0),
        _unit("c", east=4.0),
    ]

    assert pair_units(before, after) == [
        (0, 1),
        (1, 0),
        (2, None),
        (None, 2),
    ]
    assert pair_units(before, before) == [
        (0, 0),
        (1, 1),
        (2, 2),
    ]


def test_another_sensor_at_the_place_is_another_unit():
    lidar = pick_sensor("carla-ncap-lidar", "test")
    assert pair_units([_unit("U1")], [_unit("a", sensor=lidar)]) == [
        (0, None),
        (None, 0),
    ]


def test_a_moved_unit_keeps_its_name_and_says_by_how_much():
    zoom = pick_sensor("varifocal-1080p", "test")
    before = Layout(
        name="best-2",
        units=(_unit("U1", yaw=175.0), _unit("U2", east=9.0, sensor=zoom)),
    )
    poses = [
        _unit(
            "x/1",
            east=9.0,
            sensor=with_fov(zoom, 50.0, "test"),
            height=6.5,
        ),
        _unit("x/2", yaw=-178.0, pitch=-17.5),
    ]

    layout, moves = rename(
        before,
        poses,
        named=["RSU1"],
        name="refined-2",
    )

    assert layout.name == "refined-2"
    assert [unit.id for unit in layout.units] == ["U1", "U2"]

    expected = [poses[1].pose, poses[0].pose]

    assert [unit.pose for unit in layout.units] == expected

    first, second = moves

    assert first.is_same_place
    assert (first.turn_deg, first.tilt_deg, first.lift_m) == pytest.approx(
        (7.0, -2.5, 0.0)
    )
    assert first.zoom_deg == 0.0
    assert second.lift_m == pytest.approx(1.5)
    assert second.zoom_deg == pytest.approx(-39.6)


def test_what_stayed_as_it_was_is_no_move():
    before = Layout(name="best-2", units=(_unit("U1"), _unit("RSU3", east=9.0)))
    poses = [_unit("pole/5m/0/-15/c"), _unit("RSU3", east=9.0)]

    layout, moves = rename(before, poses, named=["RSU3"], name="n")

    assert [unit.id for unit in layout.units] == ["U1", "RSU3"]
    assert moves == ()


def test_a_named_pose_that_is_turned_is_no_longer_called_so():
    before = Layout(name="best-1", units=(_unit("RSU3"),))

    layout, (move,) = rename(
        before,
        [_unit("RSU3/5m/9/-15/c", yaw=9.0)],
        named=["RSU3"],
        name="n",
    )

    assert [unit.id for unit in layout.units] == ["U1"]
    assert move.before is before.units[0]
    assert move.turn_deg == 9.0


def test_new_units_get_names_that_are_free_and_lost_ones_are_told():
    before = Layout(name="best-2", units=(_unit("U1"), _unit("U2", east=9.0)))
    poses = [
        _unit("a", yaw=4.0),
        _unit("b", east=20.0),
        _unit("c", east=30.0),
    ]

    layout, moves = rename(before, poses, named=[], name="n")

    assert [unit.id for unit in layout.units] == ["U1", "U3", "U4"]

    told = [(m.before and m.before.id, m.after and m.after.id) for m in moves]

    assert told == [
        ("U1", "U1"),
        ("U2", None),
        (None, "U3"),
        (None, "U4"),
    ]
    assert [move.is_same_place for move in moves] == [True, False, False, False]


def test_a_lidar_has_no_lens_to_zoom():
    lidar = pick_sensor("carla-ncap-lidar", "test")
    unit = _unit("U1", sensor=lidar)
    after = replace(unit, id="U1")
    move = Move(before=unit, after=after)

    assert move.zoom_deg == 0.0
