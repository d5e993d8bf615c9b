"""Sources of pictures: all load, unknown ones are refused."""

import numpy as np
import pytest
from refusals import refused_with

from geometry.registry import load_entry
from geometry.study_scene import load_study_scene
from placement.evaluator.picture_sources import (
    PICTURE_SOURCES,
    build_picture_source,
    to_jpeg,
)


@pytest.mark.parametrize("name", PICTURE_SOURCES)
def test_every_picture_source_loads_and_has_drawn_nothing_yet(name):
    assert callable(load_entry(PICTURE_SOURCES[name]))

    source = build_picture_source(
        load_study_scene(),
        [],
        seed=0,
        name=name,
    )

    assert source.n_drawn == 0
    assert callable(source.pictures)
    assert callable(source.crops)

    source.close()


def test_an_unknown_picture_source_is_refused():
    with refused_with("pictures: got 'painted'; expected one of rendered"):
        build_picture_source(
            load_study_scene(),
            [],
            seed=0,
            name="painted",
        )


def test_a_jpeg_begins_as_such_files_do():
    assert to_jpeg(np.zeros((2, 3, 3), dtype=np.uint8)).startswith(b"\xff\xd8\xff")
