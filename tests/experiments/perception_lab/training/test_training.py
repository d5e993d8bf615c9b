"""A network trained for a short time beats chance; its file says what the network
says.
"""

import numpy as np
import pytest

from experiments.perception_lab.training.crops import (
    CROP_PX,
    LabelledCrops,
    load_crops,
    save_crops,
)

torch = pytest.importorskip("torch", reason="the group `train` is not installed")


def _toys(n_crops, seed):
    """Bright upright bars with a dark head in noise; every fifth crop is empty."""
    rng = np.random.default_rng(seed)
    rgb = rng.normal(90.0, 12.0, (n_crops, CROP_PX, CROP_PX, 3))
    boxes = np.zeros((n_crops, 4))
    classes = np.full(n_crops, -1)
    for row in range(n_crops):
        if row % 5 == 0:
            continue
        width = rng.integers(12, 24)
        height = rng.integers(40, 80)
        left = rng.integers(0, CROP_PX - width)
        top = rng.integers(0, CROP_PX - height)
        rgb[row, top : top + height, left : left + width] = 220.0
        rgb[row, top : top + 10, left : left + width] = 20.0
        boxes[row] = (left, top, left + width, top + height)
        classes[row] = 0
    heights = boxes[:, 3] - boxes[:, 1]
    return LabelledCrops(
        rgb=rgb.clip(0, 255).astype(np.uint8),
        box_px=boxes,
        height_px=heights,
        visible_share=(classes >= 0).astype(float),
        vru_class=classes,
        weather=np.zeros(n_crops, dtype=np.int64),
    )


@pytest.fixture(scope="module")
def trained():
    """A small network after a few steps."""
    from experiments.perception_lab.training.network import Recipe, train

    torch.set_num_threads(1)
    told = []
    recipe = Recipe(
        steps=60,
        seed=1,
        batch=16,
        round_steps=20,
    )
    network = train(_toys(240, 0), recipe, tell=lambda *row: told.append(row[:2]))
    return network, told


def test_a_minute_of_training_beats_chance(trained):
    from experiments.perception_lab.training.card import _score, average_precision
    from experiments.perception_lab.training.network import VruNetwork, find_boxes

    network, told = trained

    assert [done for done, _ in told] == [20, 40, 60]
    assert told[-1][1] < 0.7 * told[0][1]

    test = _toys(60, 9)
    everything = np.ones(60, dtype=bool)
    learnt = average_precision(_score(test, find_boxes(network, test), everything))
    chance = average_precision(
        _score(test, find_boxes(VruNetwork().eval(), test), everything)
    )

    assert learnt > chance + 0.3


def test_the_exported_file_says_what_the_network_says(trained, tmp_path):
    pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    from experiments.perception_lab.training.network import export_onnx, find_boxes
    from placement.detectors.network import boxes_of_class, load_onnx_model

    network, _ = trained
    path = tmp_path / "toy.onnx"
    export_onnx(network, path, side_px=CROP_PX)
    test = _toys(12, 4)
    model = load_onnx_model(path)
    for rgb, by_class in zip(test.rgb, find_boxes(network, test), strict=True):
        boxes, how_sure = boxes_of_class(model.detect(rgb), "pedestrian")
        sure = by_class[0][1] >= 0.06
        assert boxes[how_sure >= 0.06] == pytest.approx(by_class[0][0][sure], abs=0.05)


def test_training_that_was_stopped_goes_on(tmp_path):
    from experiments.perception_lab.training.network import Recipe, train

    class Stop(Exception):
        pass

    def stop(done, loss, network):
        if done == 2:
            raise Stop

    crops = _toys(32, 2)
    recipe = Recipe(
        steps=4,
        seed=3,
        batch=8,
        round_steps=2,
    )
    whole = train(crops, recipe).state_dict()

    with pytest.raises(Stop):
        train(crops, recipe, tell=stop, checkpoint=tmp_path / "state.pt")

    resumed = train(crops, recipe, checkpoint=tmp_path / "state.pt").state_dict()
    for name, value in whole.items():
        assert torch.allclose(value.float(), resumed[name].float(), atol=1e-6), name


def test_crops_are_kept(tmp_path):
    crops = _toys(5, 1)
    save_crops(tmp_path / "crops.npz", crops)
    read = load_crops(tmp_path / "crops.npz")

    for name in LabelledCrops.__slots__:
        assert np.array_equal(getattr(read, name), getattr(crops, name))
