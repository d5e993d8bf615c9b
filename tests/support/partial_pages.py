"""Sections of the report by themselves, as the page shows them."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any
from zlib import crc32

import msgspec
import numpy as np
import pytest
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.text import Text
from PIL import Image

from experiments.figures import dangers, plan
from experiments.figures.axes import root_figure
from experiments.parts import camera_views, section
from experiments.parts.result import KINDS, Result
from experiments.parts.section import Section, Table
from experiments.report.page import page_environment
from experiments.results import cached
from experiments.scene import pictures
from geometry.poses import Pose
from geometry.sensors import CameraModel
from placement.cache import cached_value
from placement.evaluator.picture_sources import PictureOfFrame


def blank_png(drawn: Axes | Figure) -> bytes:
    """A picture as large as a figure, of one colour that is told by the words in it."""
    figure = root_figure(drawn)
    # What is written by hand: ticks are made when somebody asks for them, which takes
    # long.
    artists = [figure, *figure.axes, *(axes.get_legend() for axes in figure.axes)]
    texts = [text for artist in artists if artist for text in _texts(artist)]
    words = " ".join(text.get_text() for text in texts)
    size = tuple(round(inches * figure.dpi) for inches in figure.get_size_inches())
    file = BytesIO()
    picture = Image.new("P", size)
    picture.putpalette(crc32(words.encode()).to_bytes(4)[1:])
    picture.save(file, format="png", compress_level=1)
    return file.getvalue()


def _texts(artist: Artist) -> list[Text]:
    """Texts of an artist that are written by hand."""
    if isinstance(artist, Axes):
        labels = (artist.xaxis.label, artist.yaxis.label, artist.title)
        return [*labels, *artist.texts]
    return list(artist.get_texts() if isinstance(artist, Legend) else artist.texts)


class BlankSource:
    """A picture source whose images are of one grey that is told by the frame."""

    def pictures(self, camera: tuple[Pose, CameraModel]) -> PictureOfFrame:
        """Function from a frame to an image as large as the camera's."""
        _, model = camera
        shape = (model.height_px, model.width_px, 3)
        return lambda frame: np.full(shape, frame % 256, dtype=np.uint8)


def _never_cached(
    make_or_read: Callable[..., Any], folder: Path | None, *given: Any, **named: Any
) -> Any:
    """Make a value anew, whatever is cached."""
    return make_or_read(None, *given, **named)


@contextmanager
def blank_pictures() -> Iterator[None]:
    """Reports have blank pictures: drawing takes long, and most tests look at words.

    Lanes and buildings, which have no words, are left out before that; what cameras see
    is grey.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(section, "to_png", blank_png)
        for module in (dangers, pictures, plan):
            patch.setattr(module, "draw_scene", lambda axes, scene: None)
        patch.setattr(camera_views, "_pictures_of", lambda *_, **__: BlankSource())
        # A blank picture is no picture for the next call.
        patch.setattr(cached, "cached_value", partial(_never_cached, cached_value))
        yield


def render_section(section: Section | None) -> str:
    """A section as the report has it: escaped; empty where there is none."""
    if section is None:
        return ""
    source = (
        '{% from "blocks.html.j2" import show_section %}{{ show_section(section) }}'
    )
    return page_environment().from_string(source).render(section=section)


def tables_of(section: Section) -> list[Table]:
    """Its tables."""
    return [block for block in section.blocks if isinstance(block, Table)]


A_UNIT = {
    "id": "U1",
    "site": "",
    **dict.fromkeys(("x_m", "y_m", "z_m", "yaw_deg", "pitch_deg"), 0.0),
    "camera": "carla-ncap-rgb",
}


def build_result(name, layout=(A_UNIT,), **changes) -> Result:
    """A result that says little: an evaluation, without what `changes` say.

    With parts that only a placement or a comparison has, it is one.
    """
    evaluation = _evaluation()
    dangers = {"not_avoided": 0, "by_case": [], "by_position": []}
    plain = {
        "schema": "place-rsus/evaluation/2",
        "name": name,
        "layout": list(layout),
        "cost_eur": 0.0,
        "fusion": "any",
        "runs": 1,
        "apr": None,
        "evaluation": evaluation,
        "dangers": dangers,
        "seconds": {},
        "versions": {},
        "cases": [],
        "weathers": [],
        "detector": "any",
        "vut_sensors": [],
        "packet_loss": 0.0,
        "vam_rate": 0.0,
        "track_memory_s": None,
        "not_driven": [],
        "possible_runs": 1,
        "driven": [],
    }
    plain |= changes
    kinds = {kind: set(KINDS[kind].__struct_fields__) for kind in reversed(KINDS)}
    kind = next(
        kind for kind in ("evaluation", *_KINDS) if set(changes) <= kinds[_schema(kind)]
    )
    if kind == "comparison":
        plain = {"compared": [_compared("other")], "differences": []} | plain
    if kind == "placement":
        stage = {
            "name": "apr",
            "objective": 1.0,
            "bound": 1.0,
            "gap": 0.0,
            "seconds": 0.0,
        }
        plain = {
            "goal": "best",
            "budget": None,
            "candidates": 1,
            "presolve": "",
            "stages": [stage],
            "solver": "",
            **dict.fromkeys(("bound", "gap", "apr_without_worst_site", "baseline")),
            **dict.fromkeys(
                ("spent_eur", "apr_without_worst_unit", "surrogate_disagreement"), 0.0
            ),
            "failing": "unit",
            "greedy": _compared("greedy"),
            "disagreements": [],
            "explained": {"not_avoided": [], "runs_without_weight": 0},
            "baselines": {"random": None, "expert": None},
        } | plain
    return msgspec.convert(plain | {"schema": _schema(kind)}, KINDS[_schema(kind)])


_KINDS = ("comparison", "placement")


def _schema(kind):
    return f"place-rsus/{kind}/2"


def _evaluation():
    """Ratios of which none is known."""
    party = {"all": None, "by_case": {}}
    parties = dict.fromkeys(("vut", "rsu_all", "vut_and_rsus"), party)
    return {**parties, "units": {}, "apr_without_worst_unit": None}


def _compared(name):
    """A layout beside another one, as results have it."""
    return {
        "name": name,
        "layout": [A_UNIT],
        "cost_eur": 0.0,
        "evaluation": _evaluation(),
        "runs_gained": [],
        "runs_lost": [],
    }
