import pytest

from geometry import raycast
from geometry.errors import InputError
from placement import compute


def test_the_libraries_that_can_be_asked_for_are_those_that_cast_rays():
    assert compute.RAYS == raycast.RAYS


def test_an_unknown_library_for_rays_is_refused_with_the_known_ones():
    with pytest.raises(InputError) as caught:
        compute.Compute(rays="optix")
    assert str(caught.value) == "--rays: got 'optix'; expected one of auto, embree, open3d"
