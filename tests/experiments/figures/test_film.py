"""Pictures of a run over time, and films of them."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from refusals import refused_with

from experiments.figures import film as film_figure
from experiments.figures.film import plot_film, save_film
from geometry.study_scene import load_study_scene
from placement.question import Question
from placement.setting import drive_one


def run_of(case, approach="east", speeds="40"):
    """A run of a case."""
    return drive_one(
        Question(cases=case, approaches=approach, speeds=speeds), load_study_scene()
    )


@pytest.fixture(scope="module")
def child():
    """A child behind parked cars."""
    return run_of("CPNCO-50")


@pytest.fixture(scope="module")
def strip(child):
    """Panels of the child's run: looked at, not changed."""
    return plot_film(load_study_scene(), child)


def captions(panels):
    """Titles of panels."""
    return [axes.get_title() for axes in panels]


@pytest.mark.long
def test_a_strip_leads_over_the_last_useful_frame_to_the_impact(child, strip):
    titles = captions(strip)
    assert len(titles) == 6

    last = child.time_s[child.time_s <= child.last_brake_time_s].max()
    assert titles[3].startswith(f"\N{MINUS SIGN}{-last:.1f} s: ")
    assert titles[5].startswith("impact: ")


@pytest.mark.long
def test_the_parked_cars_hide_the_child_until_late(strip):
    titles = captions(strip)
    shares = [int(title.split(": ")[1].split()[0]) for title in titles]

    assert shares[0] == 0
    # At the impact the child is too near to fit into the image.
    assert shares[:-1] == sorted(shares[:-1])
    assert shares[-2] == 100


@pytest.mark.long
def test_a_cyclist_beside_a_turning_vut_is_not_in_its_image():
    panels = plot_film(load_study_scene(), run_of("CBTAfs-side", "south", "15"))
    assert [title.split(": ")[1].split()[0] for title in captions(panels)] == ["0"] * 6


def test_bodies_stand_where_the_run_has_them(child, strip):
    vut = child.encounter.vut
    corners = strip[-1].patches
    middles = np.array(
        [
            np.asarray(patch.get_xy())[:4].mean(axis=0)
            for patch in corners
            if hasattr(patch, "get_xy") and len(np.atleast_2d(patch.get_xy())) == 5
        ]
    )

    for position in (child.vut_position_m[-1], child.vru_position_m[-1]):
        assert np.hypot(*(middles - position).T).min() == pytest.approx(0.0, abs=1e-9)

    assert vut.length_m > 4.0


@pytest.mark.long
def test_a_still_is_written_in_the_form_that_the_name_asks_for(child, tmp_path):
    path = tmp_path / "film.png"
    # Not in the font: as in to_png.
    own = replace(child, case=replace(child.case, name="雪"))
    save_film(path, load_study_scene(), own)

    assert path.read_bytes().startswith(b"\x89PNG")
    assert list(tmp_path.iterdir()) == [path]


# Quickly: a single picture, above
@pytest.mark.long
def test_an_animation_has_a_picture_per_frame_and_tells_its_progress(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(film_figure, "_SHOWN_S", 0.1)
    monkeypatch.setattr(film_figure, "_DPI", 40)
    run = run_of("CPNCO-50", speeds="20")
    path = tmp_path / "film.gif"
    told = []
    save_film(
        path,
        load_study_scene(),
        run,
        progress=lambda stage, *done: told.append(done),
    )

    with Image.open(path) as film:
        n_frames = film.n_frames
        milliseconds = film.info["duration"]

    shown = run.time_s >= max(
        run.encounter.vru_motion.start_time_s, run.last_brake_time_s - 0.1
    )

    assert n_frames == len(told) == shown.sum()
    assert milliseconds == 100


def test_an_unknown_form_is_refused_before_anything_is_written(child, tmp_path):
    with refused_with(
        f"--out: got '{tmp_path}/film.mov'; expected a name that ends in .png or .gif"
    ):
        save_film(tmp_path / "film.mov", load_study_scene(), child)
    assert list(tmp_path.iterdir()) == []
