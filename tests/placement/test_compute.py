"""Settings of computations."""

import pickle
from dataclasses import replace

from refusals import refused_with

from geometry import raycast
from placement import compute


def test_the_libraries_that_can_be_asked_for_are_those_that_cast_rays():
    assert compute.RAYS == raycast.RAYS


def test_an_unknown_library_for_rays_is_refused_with_the_known_ones():
    with refused_with("rays: got 'optix'; expected one of auto, embree, open3d"):
        compute.Compute(rays="optix")


def test_a_copy_for_another_process_tells_nobody():
    told = []
    here = compute.Compute(
        seed=3,
        workers=2,
        rays="embree",
        progress=lambda *step: told.append(step),
    )
    there = pickle.loads(pickle.dumps(here))
    expected = replace(here, progress=compute.silent)

    assert there == expected

    there.progress("evaluate", 1, 2)

    assert told == []
