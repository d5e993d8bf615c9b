from io import BytesIO

import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib.image import imread

from experiments.figures.actors import (
    cast_view,
    main,
    plot_bodies,
    shade_view,
)
from geometry.actors import load_actors


def _outline_m(shape, side_deg, size_m=(6.0, 2.2)):
    """Left and right end, and top, of the outline."""
    depth_m = cast_view(shape, side_deg, size_m=size_m, width_px=600)
    rows, columns = np.nonzero(np.isfinite(depth_m))
    top_m = size_m[1] - 0.06 - rows.min() * 0.01
    return columns.min() * 0.01 - 3.0, (columns.max() + 1) * 0.01 - 3.0, top_m


@pytest.mark.parametrize("name", load_actors())
def test_an_outline_is_as_wide_as_the_body_from_that_side(name):
    actor = load_actors()[name]
    for shape in actor.shapes[::3]:
        low, high = shape.vertices_m.min(axis=0), shape.vertices_m.max(axis=0)
        for side_deg, left, right in (
            (0, low[1], high[1]),
            (90, -high[0], -low[0]),
            (180, -high[1], -low[1]),
            (270, low[0], high[0]),
        ):
            expected = (left, right, high[2])
            assert _outline_m(shape, side_deg) == pytest.approx(expected, abs=0.021)


def test_light_comes_from_the_right_and_nothing_is_paper():
    (shape,) = load_actors()["vut"].shapes
    grey = shade_view(shape, 45.0, size_m=(5.4, 1.7), width_px=270)
    assert grey.shape == (85, 270)
    assert (grey[:5] == 1.0).all()
    # From ahead and left, the car's left side is on the right.
    middle = grey[50]
    assert np.median(middle[180:230]) > np.median(middle[60:100]) + 0.2


def test_every_body_is_drawn_from_eight_sides():
    actors = load_actors()
    panels = plot_bodies(actors, pixels_per_view=24)
    assert [panel.get_ylabel().split("\n")[0] for panel in panels] == list(actors)
    for panel in panels:
        (image,) = panel.get_images()
        strip = np.asarray(image.get_array())
        views = np.split(strip, 8, axis=1)
        assert all((view < 1.0).any() for view in views)
    buffer = BytesIO()
    panels[0].figure.savefig(buffer, format="png")
    assert imread(BytesIO(buffer.getvalue())).shape[2] == 4


def test_the_command_writes_the_figure(tmp_path, monkeypatch):
    one = {"child": load_actors()["child"]}
    monkeypatch.setattr("experiments.figures.actors.load_actors", lambda: one)
    done = CliRunner().invoke(main, ["--out", str(tmp_path / "bodies.png")])
    assert done.exit_code == 0
    assert (tmp_path / "bodies.png").read_bytes().startswith(b"\x89PNG")
