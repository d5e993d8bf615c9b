"""Drawn pictures before a detector of others, and on a page."""

import itertools
from dataclasses import dataclass

import numpy as np
import pytest
from PIL import Image

from experiments.perception_lab.training import pictures
from experiments.perception_lab.training.crops import (
    CROP_PX,
    Crops,
    Framing,
    look_around,
    save_crops,
)
from experiments.perception_lab.training.pictures import photographs_text
from geometry.errors import InputError
from geometry.study_scene import load_study_scene
from placement.detectors.evidence import VRU_CLASSES
from placement.detectors.network import ImageBoxes
from placement.question import Question
from placement.setting import build_setting


@pytest.fixture(scope="module")
def setting():
    question = Question(
        cases="CPNA-75,CPNCO-50", along_arms="0", speeds="20", approaches="east"
    )
    return build_setting(question, load_study_scene())


@pytest.mark.parametrize("kind", ["pedestrian", "child"])
def test_crops_are_of_the_asked_size_kind_and_height(setting, kind):
    framing = Framing(
        height_px=(60.0, 90.0),
        crop_px=(200, 160),
        empty_share=0.0,
        kinds=(kind,),
        weathers=("day",),
    )
    look = look_around(setting, framing, np.random.default_rng(1))
    row = next(row for row in look if row["visible_share"] > 0.9)
    assert row["rgb"].shape == (160, 200, 3)
    assert VRU_CLASSES[row["vru_class"]] == kind
    assert 50.0 < row["height_px"] < 100.0
    assert row["weather"] == 0


def test_road_users_that_no_case_has_are_refused(setting):
    look = look_around(setting, Framing(kinds=("cyclist",)), np.random.default_rng(0))
    with pytest.raises(InputError, match="expected cyclist"):
        next(look)


def test_forty_kept_crops_are_on_a_page(tmp_path):
    rng = np.random.default_rng(0)
    n = 90
    crops = Crops(
        rgb=rng.integers(0, 255, (n, CROP_PX, CROP_PX, 3)).astype(np.uint8),
        box_px=np.tile([10.0, 10.0, 40.0, 90.0], (n, 1)),
        height_px=np.full(n, 80.0),
        visible_share=np.ones(n),
        vru_class=np.arange(n) % 3,
        weather=np.arange(n) // 3 % 3,
    )
    dark = np.flatnonzero(crops.weather == 1)[::2]
    crops.rgb[dark] //= 100
    save_crops(tmp_path / "here-11.npz", crops)
    told = []
    sheet = pictures.draw_sheet(
        pictures.stored_looks(tmp_path, seed=0), tell=told.append
    )
    assert sheet.size == (8 * CROP_PX, 5 * (CROP_PX + pictures._CAPTION_PX))
    assert told[0] == "1 of 40: adult, day, 80 px, here"
    assert told[-2].startswith("40 of 40: ")
    assert told[-1].endswith(" left out: no light reaches them")
    assert 0 < int(told[-1].split()[0]) <= len(dark)
    tiles = np.asarray(sheet).reshape(5, CROP_PX + pictures._CAPTION_PX, 8, CROP_PX, 3)
    assert (tiles[:, :CROP_PX].max(axis=(1, 3, 4)) > 100).all()
    assert sum("cyclist, rain" in words for words in told) == 4
    # The first tile is a crop of that class and weather.
    first = np.asarray(sheet)[:CROP_PX, :CROP_PX]
    (row,) = np.flatnonzero((crops.rgb == first).all(axis=(1, 2, 3)))
    assert crops.vru_class[row] == 0
    assert crops.weather[row] == 0


def test_a_page_of_nothing_but_darkness_is_refused():
    row = {
        "rgb": np.zeros((CROP_PX, CROP_PX, 3), np.uint8),
        "box_px": np.array([9, 9, 40, 90]),
    }
    with pytest.raises(InputError, match="only dark ones"):
        pictures.draw_sheet([itertools.repeat(("here", row))])


def test_a_folder_without_crops_is_named(tmp_path):
    with pytest.raises(
        InputError, match=r"crops of adults, day, made by python -m exp"
    ):
        pictures.draw_sheet(pictures.stored_looks(tmp_path, seed=0))


def _label(kind, *sides):
    return " ".join([kind, "0", "0", "0.1", *map(str, sides), *["0"] * 8]) + "\n"


def test_photographs_with_labels_are_shown_to_a_network(tmp_path):
    @dataclass
    class Seen:
        """Finds the red block whole, as a person, and a box at the upper left on
        nothing.
        """

        min_confidence = 0.5

        def look(self, image):
            rows, columns = np.nonzero(image[..., 0] > 200)
            block = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
            boxes = np.array([block, [0, 0, 9, 9], block], dtype=float)
            return ImageBoxes(
                boxes, np.array([0, 0, 1]), np.array([0.9, 0.6, 0.4]), {0: "person"}
            )

    picture = np.zeros((100, 200, 3), np.uint8)
    picture[20:70, 50:70] = (255, 0, 0)
    (tmp_path / "image_2").mkdir()
    (tmp_path / "label_2").mkdir()
    Image.fromarray(picture).save(tmp_path / "image_2" / "a.png")
    labels = tmp_path / "label_2" / "a.txt"
    labels.write_text(
        _label("Pedestrian", 50, 20, 70, 70)
        + _label("pedestrian", 100, 20, 120, 60)
        + _label("cyclist", 55, 20, 70, 70)
        + _label("Car", 0, 0, 9, 9)
    )
    text = photographs_text(tmp_path, Seen())
    assert text.startswith(
        "1 photographs; boxes of confidence 0.5 and more: 2, of them on nobody: 1."
    )
    assert (
        "| pedestrian | 2 | 40 to 50 px | 1 |\n| cyclist | 1 | 50 to 50 px | 1 |"
        in text
    )
    labels.write_text("Pedestrian 0 0\n")
    with pytest.raises(
        InputError, match=r"a\.txt:1: got 3 fields; expected 8 to 16 fields"
    ):
        photographs_text(tmp_path, Seen())
    (tmp_path / "image_2" / "a.png").write_bytes(b"no picture")
    with pytest.raises(
        InputError, match=r"a\.png: got cannot identify .*; expected a picture"
    ):
        photographs_text(tmp_path, Seen())
    labels.unlink()
    with pytest.raises(InputError, match="label_2: got no labels; expected files NAME"):
        photographs_text(tmp_path, Seen())
