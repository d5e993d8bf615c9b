import numpy as np
import pytest
from hypothesis import given
from strategies import angles_deg, coordinates_m, numbers

from geometry.errors import InputError
from geometry.poses import body_rotation
from scenarios.paths import Motion, StraightPath


@given(coordinates_m, coordinates_m, angles_deg, coordinates_m)
def test_a_straight_path_goes_the_distance_in_the_bodys_own_direction(east, north, yaw, distance):
    path = StraightPath(start_m=[east, north], yaw_deg=yaw)
    position, heading = path.at(distance)
    assert position - path.start_m == pytest.approx(distance * body_rotation(yaw)[:2, 0], abs=1e-9)
    assert np.linalg.norm(path.direction) == pytest.approx(1.0, abs=1e-15)
    assert heading == yaw


def test_a_path_answers_for_any_shape_of_distances():
    path = StraightPath(start_m=[1.0, 2.0], yaw_deg=90.0)
    position, heading = path.at(np.arange(6.0).reshape(2, 3))
    assert position.shape == (2, 3, 2)
    assert heading.shape == (2, 3)
    assert position[1, 2] == pytest.approx([1.0, 7.0])


@given(numbers(0.1, 30.0), numbers(-20.0, 0.0), numbers(-30.0, 10.0), numbers(0.0, 10.0))
def test_a_motion_stands_until_its_start_and_then_keeps_its_speed(speed, start_s, time_s, later_s):
    motion = Motion(
        path=StraightPath(start_m=[0.0, 0.0], yaw_deg=0.0), speed_mps=speed, start_time_s=start_s
    )
    if time_s <= start_s:
        assert motion.distance_m(time_s) == 0.0
    else:
        driven = motion.distance_m(time_s + later_s) - motion.distance_m(time_s)
        assert driven == pytest.approx(speed * later_s, abs=1e-9)
    assert motion.distance_m(start_s) == 0.0


def test_a_start_with_a_height_is_refused():
    with pytest.raises(InputError) as caught:
        StraightPath(start_m=[0.0, 1.0, 2.0], yaw_deg=0.0)
    assert str(caught.value) == "start_m: got shape (3,); expected shape (2,)"
