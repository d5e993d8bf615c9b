"""The network that is shipped: ``--detector cnn``."""

import sys
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
from evidences import build_evidence
from met_cases import MET_CASES
from refusals import refused_with

from geometry.errors import InputError, MissingExtraError
from placement.detectors import load_detector, load_planning_detector, network
from placement.detectors.evidence import Crop
from placement.question import Question
from placement.setting import build_setting


@pytest.fixture(autouse=True)
def _anew():
    """Loads the shipped network anew, and leaves none behind."""
    network.load_shipped_network.cache_clear()
    yield
    network.load_shipped_network.cache_clear()


def test_it_is_small_and_has_a_card():
    data = files("placement.detectors") / "data"

    assert len((data / "vru.onnx").read_bytes()) < 5e6

    card = (data / "vru.md").read_text(encoding="utf-8")

    for word in (
        "Apache-2.0",
        "AP50",
        "log-average miss rate",
        "junctions that it has never seen",
    ):
        assert word in card


def test_the_extra_is_named_where_onnxruntime_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(
        MissingExtraError, match=r"needs onnxruntime: pip install place-rsus\[perc"
    ):
        load_detector("cnn")


def test_plans_are_made_with_the_table_that_was_fitted_to_it():
    pytest.importorskip("onnxruntime")
    network = load_detector("cnn")

    assert network.needs_pictures

    table = load_planning_detector(network.plans_with)

    assert table.name == "cnn-table"
    assert "response table fitted to it" in network.description


def test_what_it_has_not_learnt_is_refused():
    pytest.importorskip("onnxruntime")
    network = load_detector("cnn")

    network.check_classes(["pedestrian", "child", "cyclist"])

    for name, known in (
        ("car", "car"),
        ("motorcyclist", "motorcycle or motorcyclist"),
    ):
        with refused_with(
            f"detector cnn: got runs with a {name}; expected a network that knows"
            f" {known}"
        ):
            network.check_classes(["pedestrian", name])


def test_runs_with_it_are_checked_before_anything_is_built(caplog):
    pytest.importorskip("onnxruntime")
    met = Question(
        cases=str(MET_CASES),
        protect="all",
        approaches="east",
        along_arms="0",
    )

    with pytest.raises(
        InputError, match="detector cnn: got runs with a car; expected a network"
    ):
        build_setting(replace(met, detector="cnn"))

    build_setting(replace(met, detector="cnn-table"))

    words = "how well the detector finds motorcyclist (factor 1) and car (factor 1)"

    assert words in caplog.text


class _Crops:
    """Plain grey crops, of which rows with the same number look the same."""

    def __init__(self, numbers):
        self.numbers, self.drawn = numbers, []

    def key(self, row):
        return self.numbers[row]

    def draw_all(self, rows):
        for row in rows:
            self.drawn.append(row)
            pixels = np.full((64, 64, 3), 120, dtype=np.uint8)
            yield (
                row,
                Crop(
                    pixels=pixels,
                    left_px=0.0,
                    top_px=0.0,
                    scale=1.0,
                    middle_px=(0.0, 0.0),
                ),
            )


def _evidence(heights, crops):
    """Evidence of boxes of these heights, and their crops. [px]"""
    boxes = [[10.0, 10.0, 20.0, 10.0 + height] for height in heights]
    return replace(build_evidence(boxes), crops=crops)


def test_what_looks_the_same_is_shown_once_and_what_is_too_small_never():
    pytest.importorskip("onnxruntime")
    crops = _Crops(["a", "b", "a", "c", "b"])
    found = load_detector("cnn").detect(
        _evidence([30.0, 30.0, 30.0, 5.0, 30.0], crops), np.random.default_rng(0)
    )

    assert crops.drawn == [0, 1]
    assert len(found.row_index) == 0  # nobody is in a grey crop


def test_boxes_of_a_crop_are_moved_into_the_image():
    pixels = np.zeros((8, 8, 3), dtype=np.uint8)
    crop = Crop(
        pixels=pixels,
        left_px=-100.0,
        top_px=20.0,
        scale=2.0,
        middle_px=(960.0, 540.0),
    )
    moved = crop.to_image(np.array([[0.0, 0.0, 10.0, 20.0]]))

    assert moved.tolist() == [[760.0, 580.0, 780.0, 620.0]]
