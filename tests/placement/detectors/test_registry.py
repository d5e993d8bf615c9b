"""Every registered detector and reader of detectors can be loaded."""

import sys

import numpy as np
import pytest

from geometry.errors import MissingExtraError
from geometry.registry import load_entry
from placement.detectors import load_detector
from placement.detectors.evidence import VRU_CLASSES, LidarTable
from placement.detectors.registry import (
    DETECTOR_FILES,
    DETECTORS,
    LIDAR_TABLES,
    is_drawn,
)


@pytest.mark.parametrize("name", DETECTORS)
def test_every_detector_loads_and_has_what_the_protocol_asks_for(name):
    if name == "cnn":
        pytest.importorskip("onnxruntime")

    detector = load_detector(name)

    assert detector.name == name
    assert detector.needs_pictures == bool(detector.seconds_per_picture)
    assert detector.plans_with in ("", *DETECTORS)

    detector.check_classes(["pedestrian"])

    assert isinstance(detector.assumed_words(VRU_CLASSES), str)
    assert isinstance(detector.figures_words, str)

    if not detector.plans_with:
        assert detector.is_drawn == is_drawn(name)


@pytest.mark.parametrize("suffix", DETECTOR_FILES)
def test_every_reader_of_detectors_loads(suffix):
    assert callable(load_entry(DETECTOR_FILES[suffix]))


@pytest.mark.parametrize("name", LIDAR_TABLES)
def test_every_table_of_lidars_loads(name):
    table = load_entry(LIDAR_TABLES[name])(name)

    assert isinstance(table, LidarTable)

    share = table.probability(np.array([10.0]), np.array([0]))

    assert 0.0 < share[0] <= 1.0


def test_a_network_names_the_extra_that_it_needs(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    path = tmp_path / "mine.onnx"
    path.write_bytes(b"no network, but the library is asked for first")

    with pytest.raises(MissingExtraError) as refused:
        load_detector(str(path))

    assert "pip install place-rsus[perception]" in str(refused.value)
