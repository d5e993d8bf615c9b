"""Pictures of the report: their size and palette."""

import base64
import io

import matplotlib.image
import numpy as np
import pytest
from PIL import Image

from experiments.figures.axes import new_axes, to_png
from experiments.parts import section
from experiments.parts.section import MAX_TRUE_COLOUR_BYTES, build_picture, with_palette


def test_a_picture_is_the_whole_figure_whether_asked_by_it_or_by_its_axes():
    words = {"title": "t", "caption": "c", "alt": "a"}
    pictures = []
    for which in (0, 1):
        axes = new_axes(3.0, 2.0)
        axes.plot([0.0, 1.0])
        pictures.append(build_picture((axes.figure, axes)[which], **words))
    picture, other = pictures

    assert other == picture

    image = matplotlib.image.imread(io.BytesIO(base64.b64decode(picture.image)))
    assert image.shape[:2] == (picture.height_px, picture.width_px) == (320, 480)
    assert picture.width_in == 3.0
    assert picture.title == "t"
    assert picture.caption == "c"
    assert picture.alt == "a"


def test_axes_without_a_figure_are_no_picture():
    axes = new_axes(3.0, 2.0)
    axes.remove()
    with pytest.raises(ValueError, match="no figure"):
        build_picture(axes, title="", caption="", alt="")


def as_png(levels):
    """Levels, (h, w, 3), as a file."""
    buffer = io.BytesIO()
    Image.fromarray(levels).save(buffer, format="png")
    return buffer.getvalue()


def levels_of(png):
    """Levels of a file, (h, w, 3)."""
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


def draw_many_lines():
    """A figure of many shades in which one small mark has a colour of its own."""
    axes = new_axes(6.0, 6.0)
    rng = np.random.default_rng(0)
    for colour in ("#0072B2", "#009E73", "#CC79A7"):
        axes.plot(
            rng.random(60), rng.random(60), color=colour, linewidth=1.0, alpha=0.7
        )
    axes.plot([0.5], [0.5], "s", color="#D55E00", markersize=4.0, zorder=9)
    return to_png(axes)


@pytest.mark.long
def test_a_large_picture_gets_a_palette_that_keeps_even_the_colour_of_a_small_mark():
    png = draw_many_lines()
    assert len(png) > MAX_TRUE_COLOUR_BYTES

    reduced = with_palette(png)
    assert len(reduced) < 0.5 * len(png)
    assert Image.open(io.BytesIO(reduced)).mode == "P"

    before = levels_of(png)
    after = levels_of(reduced)
    assert np.abs(after - before).max() <= 32

    is_mark = (before == [0xD5, 0x5E, 0x00]).all(axis=2)
    assert 20 < is_mark.sum() < 400
    assert np.abs(after[is_mark] - before[is_mark]).max() <= 16


def test_what_a_palette_would_change_or_not_shrink_stays_as_it_is(monkeypatch):
    monkeypatch.setattr(section, "MAX_TRUE_COLOUR_BYTES", 3000)
    rng = np.random.default_rng(0)
    noise = as_png(rng.integers(0, 256, (64, 64, 3), dtype=np.uint8))

    assert len(noise) > 3000
    assert with_palette(noise) == noise

    small = as_png(rng.integers(0, 256, (20, 20, 3), dtype=np.uint8))
    assert len(small) < 3000
    assert with_palette(small) == small
