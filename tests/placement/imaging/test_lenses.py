"""Pictures through lenses: against a pinhole's, along the same rays; and onto
stills.
"""

from dataclasses import replace

import numpy as np
import pytest
from camera_rays import pixel_rays
from kept_backdrops import CORNER

from geometry.lenses import BrownConrady, Fisheye, TsaiRadial
from geometry.sensors import pixel_grid, project_points
from placement.compute import Compute
from placement.imaging import draw_picture
from placement.imaging.mesh import place_mesh
from placement.imaging.picture import whole_image
from placement.imaging.stills import draw_onto, draw_still, meter, silhouette

LENSES = {
    "brown-conrady": (BrownConrady(k1=-0.12, k2=0.01, p1=0.004), 100.0),
    "tsai": (TsaiRadial(kappa=0.2), 80.0),
    "fisheye": (Fisheye(k1=-0.03, k2=0.01), 110.0),
}


COMPUTE = Compute(seed=0, workers=1)


@pytest.fixture(scope="module")
def draw(backdrop, study_run, day):
    """Draws a frame of the study's run with a camera."""

    def draw_frame(camera):
        frame = len(study_run.time_s) - 6
        return draw_picture(
            backdrop,
            study_run,
            frame,
            CORNER,
            camera,
            weather=day,
            compute=COMPUTE,
        )

    return draw_frame


@pytest.fixture(scope="module")
def through_pinhole(draw, small):
    """A camera of many pixels, and what it shows."""
    pinhole = replace(
        small,
        width_px=1200,
        height_px=1200,
        horizontal_fov_deg=130.0,
    )
    return pinhole, draw(pinhole)


@pytest.mark.long
@pytest.mark.parametrize("model", LENSES)
def test_a_lens_shows_along_each_ray_what_a_pinhole_shows_there(
    draw, through_pinhole, small, model
):
    lens, fov_deg = LENSES[model]
    camera = replace(
        small,
        horizontal_fov_deg=fov_deg,
        lens=lens,
        roll_deg=4.0,
    )
    pinhole, straight = through_pinhole
    bent = draw(camera)
    rows, columns = np.indices(bent.instance.shape).reshape(2, -1)
    ways = pixel_rays(columns, rows, CORNER, camera)

    column, row, _ = project_points(CORNER.position_m + ways, CORNER, pinhole).T
    inside = (column > 0) & (column < 1200) & (row > 0) & (row < 1200)

    assert inside.mean() > 0.9

    at = row[inside].astype(int), column[inside].astype(int)
    same = bent.instance.ravel()[inside] == straight.instance[at]

    assert same.mean() > 0.985  # a pixel of the one next to an edge of the other

    near = np.isclose(bent.depth_m.ravel()[inside], straight.depth_m[at], rtol=0.03)

    assert near.mean() > 0.97

    off = np.abs(bent.rgb.reshape(-1, 3)[inside].astype(int) - straight.rgb[at]).mean(
        axis=1
    )

    assert np.median(off) < 8.0


def test_it_is_dark_where_a_fisheye_shows_nothing(draw, small):
    camera = replace(small, horizontal_fov_deg=230.0, lens=Fisheye())
    picture = draw(camera)

    dark = np.isnan(pixel_grid(camera)).any(axis=2)

    assert 0.2 < dark.mean() < 0.8
    assert (picture.instance[dark] == -1).all()
    assert np.isinf(picture.depth_m[dark]).all()
    assert picture.rgb[dark].mean() < 30.0
    assert picture.rgb[~dark].mean() > 60.0

    # The exposure is that of what is shown: the rim does not make it white.
    straight = draw(small)
    white = [
        (rgb > 250).all(axis=1).mean()
        for rgb in (picture.rgb[~dark], straight.rgb[:, 0])
    ]

    assert white[0] < white[1] + 0.1


def test_a_dark_rim_does_not_lengthen_the_exposure_of_what_stands_still(
    backdrop, small, day
):
    camera = replace(small, horizontal_fov_deg=230.0, lens=Fisheye())
    still = place_mesh(backdrop.mesh, np.zeros(3))

    bent = meter(backdrop, still, CORNER, camera, day)
    straight = meter(backdrop, still, CORNER, small, day)

    assert bent == pytest.approx(straight, rel=0.5)


@pytest.mark.long
@pytest.mark.parametrize("model", ["brown-conrady", "fisheye"])
def test_what_moves_drawn_onto_a_still_is_the_picture_drawn_anew(
    backdrop,
    study_run,
    small,
    day,
    draw,
    model,
):
    lens, fov_deg = LENSES[model]
    camera = replace(small, horizontal_fov_deg=fov_deg, lens=lens)
    still = draw_still(
        backdrop,
        CORNER,
        camera,
        weather=day,
        compute=COMPUTE,
    )
    frame = len(study_run.time_s) - 6

    onto = draw_onto(still, study_run, frame, compute=COMPUTE)
    anew = draw(camera)

    assert np.array_equal(onto.depth_m, anew.depth_m)

    for name in ("vru", "vut"):
        index = anew.names.index(name)
        assert np.array_equal(onto.instance == index, anew.instance == index)

    levels = np.abs(onto.rgb.astype(int) - anew.rgb.astype(int)).max(axis=2)

    assert (levels > 1).mean() < 1e-3

    mask = silhouette(
        study_run,
        frame,
        CORNER,
        camera,
        whole_image(camera),
    )
    vru = anew.instance == anew.names.index("vru")

    assert vru.any()
    assert not (vru & ~mask).any()


@pytest.mark.long
def test_a_lens_of_zeros_has_the_pinholes_bits(draw, small):
    zero = replace(
        small,
        lens=BrownConrady(),
        principal_point=(0.5, 0.5),
        roll_deg=0.0,
    )
    plain = draw(small)
    bent = draw(zero)

    for name in ("rgb", "instance", "depth_m"):
        expected = getattr(bent, name)
        assert np.array_equal(getattr(plain, name), expected)
