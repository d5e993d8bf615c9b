"""Vehicles that drive by hide road users: in the detection table and in the
evaluator.
"""

from dataclasses import replace

import numpy as np
import pytest
from tiny_worlds import block_actor, table_of, unit_at

from geometry.actors import MovingActor, pick_actor
from geometry.errors import InputError
from placement.compute import DEFAULT_COMPUTE
from placement.evaluator.evaluate import unit_key, watch

LENGTH_M = 12.0
WIDTH_M = 2.5
HEIGHT_M = 3.2
SPEED_MPS = 12.0


@pytest.fixture(scope="module")
def bus():
    """A bus that is a box."""
    box = block_actor((LENGTH_M, WIDTH_M, HEIGHT_M), "bus")
    return replace(box, class_name="car")


@pytest.fixture(scope="module")
def unit():
    """A camera 3 m high that looks east."""
    return unit_at(
        "camera",
        [0.0, 0.0, 3.0],
        pitch_deg=-5.0,
        site_id="pole",
    )


@pytest.fixture(scope="module")
def scene(build_scene):
    """Nothing but a place."""
    return replace(
        build_scene(),
        outline_m=np.array(
            [
                [-9.0, -9.0],
                [9.0, -9.0],
                [9.0, 9.0],
            ]
        ),
    )


def _seen(setting, unit):
    """Frames in which a unit detects, by the table and by the evaluator."""
    table = table_of(setting, [unit])
    compute = replace(DEFAULT_COMPUTE, workers=1)
    detected = watch(setting, {unit_key(unit): unit}, compute=compute)
    return table.detected([0])[0], detected[unit_key(unit)]


def test_a_bus_hides_a_pedestrian_for_a_second(
    scene, build_run, build_setting, bus, unit
):
    """The shadow of a box, by similar triangles: the pedestrian stands twice as far as
    the bus.
    """
    adult = pick_actor("adult", "test")
    n_frames = 31
    along_m = SPEED_MPS * (np.arange(n_frames) - 15) / 10.0
    run = build_run(adult, np.tile([20.0, 0.0, 90.0], (n_frames, 1)))
    driving = MovingActor(
        actor=bus,
        position_m=np.column_stack([np.full(n_frames, 10.0), along_m]),
        yaw_deg=np.full(n_frames, 90.0),
    )
    with_bus = replace(run, traffic=(driving,))
    setting = build_setting(scene, [run, with_bus])
    # Over the roof the camera sees nothing of a body lower than this at 20 m.
    far_edge_m = 10.0 + 0.5 * WIDTH_M

    assert adult.height_m < 3.0 - (3.0 - HEIGHT_M) * 20.0 / far_edge_m

    # The rays to both sides of the body pass the near edge of the bus this far from the
    # axis.
    side_m = 0.5 * max(adult.width_m, adult.length_m) * (10.0 - 0.5 * WIDTH_M) / 20.0
    # Where the body is on the far edge's line of sight, its sides are as far out.
    is_hidden = np.abs(along_m) < 0.5 * LENGTH_M - side_m
    is_clear = np.abs(along_m) > 0.5 * LENGTH_M + 0.5 * max(
        adult.width_m, adult.length_m
    )

    assert is_hidden.sum() in (9, 10)  # a second

    for seen in _seen(setting, unit):
        alone = seen[:n_frames]
        behind = seen[n_frames:]

        assert alone.all()
        assert not behind[is_hidden].any()
        assert behind[is_clear].all()


def test_a_vehicle_has_as_many_frames_as_the_run(build_run, bus):
    run = build_run(pick_actor("adult", "test"), [[20.0, 0.0, 0.0]] * 3)
    position_m = np.zeros((2, 2))
    driving = MovingActor(actor=bus, position_m=position_m, yaw_deg=np.zeros(2))

    with pytest.raises(InputError, match="2 frames; expected 3"):
        replace(run, traffic=(driving,))
