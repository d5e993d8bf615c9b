"""What moves, drawn onto a still, against the whole picture drawn anew."""

import numpy as np
import pytest
from kept_backdrops import CORNER

from geometry.weather import load_weathers
from placement.compute import Compute
from placement.imaging import draw_picture
from placement.imaging.stills import draw_onto, draw_still

COMPUTE = Compute(seed=2, workers=1)


@pytest.fixture(
    scope="module",
    params=["day", pytest.param("night", marks=pytest.mark.long), "rain"],
)
def pictures(request, backdrop, study_run, small):
    """Three frames in a weather: anew, and onto a still."""
    weather = load_weathers()[request.param]
    how = {"weather": weather, "compute": COMPUTE}
    still = draw_still(backdrop, CORNER, small, **how)
    n_frames = len(study_run.time_s)
    pairs = []
    for back in (30, 13, 1):
        frame = n_frames - back
        anew = draw_picture(
            backdrop,
            study_run,
            frame,
            CORNER,
            small,
            **how,
        )
        onto = draw_onto(still, study_run, frame, compute=COMPUTE)
        pairs.append((anew, onto))

    return pairs


def test_the_road_users_are_in_both_at_the_same_pixels(pictures):
    for anew, onto in pictures:
        for name in ("vru", "vut"):
            index = anew.names.index(name)
            assert np.array_equal(onto.instance == index, anew.instance == index)

    assert any((onto.instance == onto.names.index("vru")).any() for _, onto in pictures)


def test_most_of_a_still_is_kept(backdrop, study_run, small):
    still = draw_still(
        backdrop,
        CORNER,
        small,
        weather=load_weathers()["day"],
        compute=COMPUTE,
    )
    before = still.smooth.copy()

    onto = draw_onto(
        still,
        study_run,
        len(study_run.time_s) - 1,
        compute=COMPUTE,
    )

    assert np.array_equal(still.smooth, before)
    assert 0.0 < (onto.instance != still.raw.instance).mean() < 0.5
