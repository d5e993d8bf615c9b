import base64
import io

import matplotlib.image
import pytest

from experiments.figures import build_figure
from experiments.pictures import build_picture


def test_a_picture_is_the_whole_figure_whether_asked_by_it_or_by_its_axes():
    words = {"title": "t", "caption": "c", "alt": "a"}
    pictures = []
    for which in (0, 1):
        drawn = build_figure(3.0, 2.0)
        drawn[1].plot([0.0, 1.0])
        pictures.append(build_picture(drawn[which], **words))
    picture, other = pictures
    assert other == picture
    image = matplotlib.image.imread(io.BytesIO(base64.b64decode(picture.png)))
    assert image.shape[:2] == (picture.height_px, picture.width_px) == (320, 480)
    assert (picture.title, picture.caption, picture.alt) == ("t", "c", "a")


def test_axes_without_a_figure_are_no_picture():
    _, axes = build_figure(3.0, 2.0)
    axes.remove()
    with pytest.raises(ValueError, match="no figure"):
        build_picture(axes, title="", caption="", alt="")
