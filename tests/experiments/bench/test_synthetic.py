"""Made-up instances: their size, and that units are worth what they should be."""

import numpy as np
from synthetic_instances import SyntheticSize, build_synthetic_instance

SIZE = SyntheticSize(
    n_sites=8,
    heights_m=(5.0, 8.0),
    n_yaws=6,
    pitches_deg=(-8.0, -22.0),
    zooms_deg=(50.0, 90.0),
    n_runs=20,
    n_frames=901,
)


def test_default_size_is_two_hundred_thousand_poses() -> None:
    assert SyntheticSize().n_poses == 200_000
    assert SyntheticSize().n_frames == 50_000


def test_instance_is_a_detection_table_of_its_size() -> None:
    instance = build_synthetic_instance(SIZE)
    table = instance.to_table()

    assert table.n_poses == SIZE.n_poses == 384
    assert table.axis.n_frames == 901
    assert table.axis.n_runs == 20
    np.testing.assert_array_equal(table.packed, instance.packed)
    assert np.bincount(instance.site_index).tolist() == [48] * 8
    # No bits beyond the last frame.
    assert not (instance.packed[:, -1] >> 5).any()


def test_same_seed_gives_the_same_whatever_the_threads_and_another_seed_another() -> (
    None
):
    one = build_synthetic_instance(SIZE, seed=3)
    two = build_synthetic_instance(SIZE, seed=3, workers=3)
    other = build_synthetic_instance(SIZE, seed=4)

    np.testing.assert_array_equal(one.packed, two.packed)
    assert (one.packed != other.packed).any()


def test_detections_follow_the_geometry() -> None:
    instance = build_synthetic_instance(SIZE)
    seen = instance.to_table().detected(slice(None))
    seen = seen.reshape(8, 2, 6, 2, 2, 901)  # site, height, yaw, pitch, zoom, frame

    assert 0.001 < seen.mean() < 0.3
    # Six yaws, 60 degrees apart: at most two cameras of 90 degrees see a VRU, one of 50
    # degrees.
    assert seen[:, :, :, :, 0].sum(axis=2).max() == 1
    assert seen[:, :, :, :, 1].sum(axis=2).max() == 2

    # A VRU that comes into sight mostly stays in sight.
    stays = (seen[..., 1:] & seen[..., :-1]).sum() / seen[..., :-1].sum()
    assert stays > 0.8
