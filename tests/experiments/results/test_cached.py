"""Parts of a result's files come from the cache only where everything is the same."""

from dataclasses import replace

import pytest

from experiments.language import speaking
from experiments.parts import units
from experiments.parts.section import Picture, Pictures
from experiments.parts.units import build_plans
from experiments.results import cached
from experiments.results.cached import cached_part
from placement.layout import load_carlancap_layout


class Drawn:
    """Pictures, and how often they were drawn."""

    def __init__(self):
        self.times = 0

    def __call__(self):
        self.times += 1
        words = {"title": f"{self.times}", "caption": "below", "alt": "all"}
        one = Picture(
            **words,
            image="aGk=",
            width_px=4,
            height_px=3,
            width_in=2.0,
        )
        return (replace(one, narrow=one), one)


@pytest.fixture
def drawn():
    return Drawn()


def picture_in(folder, draw, *made_from):
    """The part as it is cached in a folder, or made."""
    return cached_part(folder, "drawn", draw, kind=Pictures, made_from=made_from)


def test_pictures_come_back_as_they_were_drawn(tmp_path, drawn):
    first = picture_in(tmp_path, drawn, 1)
    assert picture_in(tmp_path, drawn, 1) == first
    assert drawn.times == 1


def test_other_inputs_languages_and_libraries_are_drawn_anew(
    tmp_path, drawn, monkeypatch
):
    picture_in(tmp_path, drawn, 1)
    picture_in(tmp_path, drawn, 2)
    assert drawn.times == 2

    with speaking("de"):
        picture_in(tmp_path, drawn, 1)
    assert drawn.times == 3

    monkeypatch.setattr(cached, "version_of", lambda library: "0")
    picture_in(tmp_path, drawn, 1)
    assert drawn.times == 4


def test_without_a_folder_and_from_a_damaged_file_it_is_drawn(tmp_path, drawn):
    picture_in(None, drawn, 1)
    picture_in(None, drawn, 1)
    assert drawn.times == 2

    picture_in(tmp_path, drawn, 1)
    (path,) = tmp_path.iterdir()
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    picture_in(tmp_path, drawn, 1)

    assert drawn.times == 4


@pytest.mark.parametrize(
    ("families", "n_drawn"),
    [
        ((), 1),
        (("DejaVu Sans", "Another"), 2),
        (None, 2),
    ],
)
def test_a_plan_with_letters_of_another_font_is_never_cached(
    small_setting, tmp_path, drawn, monkeypatch, families, n_drawn
):
    monkeypatch.setattr(units, "street_names", lambda scene: {"north": "Straße"})
    monkeypatch.setattr("experiments.figures.fonts.families_for", lambda _: families)
    monkeypatch.setattr(units, "_draw_plans", lambda *given: drawn())
    layout = load_carlancap_layout()
    for _ in range(2):
        build_plans(small_setting, {"study": layout}, [], cache_folder=tmp_path)

    assert drawn.times == n_drawn
