"""Users' ONNX networks of all exports, made here with known boxes."""

import re
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from refusals import refused_with
from strategies import boxes_px

from geometry.errors import InputError, MissingExtraError
from geometry.image_boxes import iou
from placement.detectors.network import (
    ImageBoxes,
    boxes_of_class,
    letterbox,
    load_onnx_model,
    suppress,
)

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
from onnx import helper, numpy_helper, parser  # noqa: E402

FREE = "float[batch, 3, height, width] images"
FIXED = "float[1, 3, 64, 64] images"
PERSON = [4.0, 8.0, 20.0, 60.0]
BICYCLE = [30.0, 20.0, 60.0, 50.0]


def save(path, graph, *, metadata=None, arrays=()):
    """Write a model in ONNX's text, with the arrays that it names."""
    model = parser.parse_model(f'<ir_version: 9, opset_import: ["": 17]> tiny {graph}')
    model.graph.initializer.extend(
        numpy_helper.from_array(np.asarray(array), f"its_{name}")
        for name, array in dict(arrays).items()
    )
    helper.set_model_props(model, metadata or {})
    onnx.save(model, path)
    return path


def save_constants(path, arrays, *, takes=FIXED, metadata=None):
    """A model that gives the same arrays for every image."""
    kinds = {"float32": "float", "int64": "int64"}
    gives = ", ".join(
        f"{kinds[str(np.asarray(array).dtype)]}[] {name}"
        for name, array in arrays.items()
    )
    nodes = "".join(f"{name} = Identity(its_{name}) " for name in arrays)
    graph = f"({takes}) => ({gives}) {{ {nodes} }}"
    return save(path, graph, metadata=metadata, arrays=arrays)


def centred(boxes):
    """Boxes as centre, width and height, (n, 4). [px]"""
    table = np.asarray(boxes, dtype=float)
    x_min, y_min, x_max, y_max = table.T
    return np.stack(
        [(x_min + x_max) / 2, (y_min + y_max) / 2, x_max - x_min, y_max - y_min], 1
    )


def one_hot(ids, scores, n_classes, rest=0.0):
    """Scores (n, n_classes), each at its class."""
    table = np.full((len(ids), n_classes), rest)
    table[np.arange(len(ids)), ids] = scores
    return table


def f32(*parts):
    """Columns side by side, as single floats."""
    return np.concatenate([np.asarray(p, dtype=float) for p in parts], axis=1).astype(
        np.float32
    )


# Ids of COCO's 91 are one more for persons and bicycles.
def as_torchvision(boxes, ids, scores):
    """Outputs as torchvision exports them."""
    return {
        "boxes": np.float32(boxes).reshape(-1, 4),
        "labels": np.int64(ids) + 1,
        "scores": np.float32(scores),
    }


def as_retinanet(boxes, ids, scores):
    """Outputs of old exports: numbers for names, another order."""
    values = as_torchvision(boxes, ids, scores)
    return {
        "_1": values["boxes"],
        "_2": values["scores"],
        "_3": values["labels"],
    }


def as_rt_detr(boxes, ids, scores):
    """Outputs as RT-DETR exports them."""
    return {
        "labels": np.int64(ids)[None],
        "boxes": np.float32(boxes)[None],
        "scores": np.float32(scores)[None],
    }


def as_yolov5(boxes, ids, scores):
    """Output of YOLOv5: boxes, objectness and scores row by row."""
    objectness = np.full((len(ids), 1), 0.96)
    scores = np.array(scores) / 0.96
    classes = one_hot(ids, scores, 80)
    output = f32(centred(boxes), objectness, classes)
    return {"output0": output[None]}


def as_yolov8(boxes, ids, scores):
    """Output of YOLOv8: the same without objectness, transposed."""
    classes = one_hot(ids, scores, 80)
    output = f32(centred(boxes), classes)
    return {"output0": output.T[None]}


def as_end_to_end(boxes, ids, scores):
    """Output with suppression done, padded by empty rows."""
    columns = np.transpose([scores, ids])
    table = f32(boxes, columns)
    padding = np.zeros((7, 6), np.float32)
    padded = np.concatenate([table, padding])
    return {"output0": padded[None]}


def as_detr(boxes, ids, scores):
    """91 classes and one for none: softmax; the logarithms of probabilities give them
    back.
    """
    class_numbers = np.add(ids, 1)
    probability = one_hot(class_numbers, scores, 92, rest=1e-9)
    sure = np.array(scores)
    probability[:, 91] = 1.0 - sure
    boxes = f32(centred(boxes) / 64.0)
    logits = np.log(probability)
    return {"logits": np.float32(logits)[None], "pred_boxes": boxes[None]}


def as_sigmoid_detr(boxes, ids, scores):
    """80 classes, each for itself."""
    probability = one_hot(ids, scores, 80, rest=1e-9)
    log_odds = np.log(probability / (1.0 - probability))
    logits = np.float32(log_odds)
    return {"pred_boxes": f32(centred(boxes) / 64.0)[None], "logits": logits[None]}


SUPPRESSED = [
    as_torchvision,
    as_retinanet,
    as_rt_detr,
    as_end_to_end,
    as_detr,
    as_sigmoid_detr,
]
DENSE = [as_yolov5, as_yolov8]
GREY = np.full((64, 64, 3), 128, dtype=np.uint8)
ONE_PERSON = as_torchvision([PERSON], [0], [0.75])


@pytest.fixture
def path(tmp_path):
    """Where the network is written."""
    return tmp_path / "net.onnx"


def save_bright(path, takes, threshold=0.5):
    """A detector of torchvision's kind: the box around all pixels with red above a
    threshold.
    """
    return save(
        path,
        f"""({takes}) => (float[] boxes, int64[] labels, float[] scores)
        <float[1] threshold = {{{threshold}}}, int64[1] zero = {{0}},
        int64[1] one = {{1}}, int64[1] labels_ = {{1}}, float[1] scores_ = {{0.75}}> {{
            numbers = Cast<to = 1>(images)
            red = Slice(numbers, zero, one, one)
            is_bright = Greater(red, threshold)
            bright = Cast<to = 1>(is_bright)
            columns = ReduceMax<axes = [1, 2], keepdims = 0>(bright)
            rows = ReduceMax<axes = [1, 3], keepdims = 0>(bright)
            x_min = ArgMax<axis = 1>(columns)
            y_min = ArgMax<axis = 1>(rows)
            x_last = ArgMax<axis = 1, select_last_index = 1>(columns)
            y_last = ArgMax<axis = 1, select_last_index = 1>(rows)
            x_max = Add(x_last, one)
            y_max = Add(y_last, one)
            corners = Concat<axis = 1>(x_min, y_min, x_max, y_max)
            boxes = Cast<to = 1>(corners)
            labels = Identity(labels_)
            scores = Identity(scores_)
        }}""",
    )


def picture(width_px, height_px, box):
    """An image (h, w, 3) that is black but for one box.

    It is red alone: the channels must come in order.
    """
    image = np.zeros((height_px, width_px, 3), dtype=np.uint8)
    x_min, y_min, x_max, y_max = box
    image[y_min:y_max, x_min:x_max, 0] = 255
    return image


def found_by(path, arrays, image=GREY, **options):
    """Boxes of a model that gives the same arrays for every image."""
    saved = save_constants(path, arrays, **options)
    model = load_onnx_model(saved)
    return model.detect(image)


# Every kind of export.


@pytest.mark.parametrize("layout", SUPPRESSED + DENSE)
def test_every_export_gives_its_boxes_classes_and_scores(path, layout):
    arrays = layout([BICYCLE, PERSON], [1, 0], [0.625, 0.875])
    found = found_by(path, arrays)
    kinds = [found.kinds[i] for i in found.class_ids]

    assert_allclose(found.boxes_px, [PERSON, BICYCLE], atol=1e-4)
    assert_allclose(found.confidence, [0.875, 0.625], rtol=1e-5)
    assert kinds == ["person", "bicycle"]
    assert found.boxes_px.dtype == found.confidence.dtype == np.float64
    assert found.class_ids.dtype == np.int64


@pytest.mark.parametrize("layout", SUPPRESSED + DENSE)
def test_boxes_of_a_class_that_overlap_are_suppressed_where_the_export_did_not(
    path, layout
):
    near = [5.0, 9.0, 21.0, 61.0]
    arrays = layout([PERSON, near, near], [0, 0, 1], [0.5, 0.75, 0.25])
    if layout in DENSE:
        confidence = [0.75, 0.25]
    else:
        confidence = [0.75, 0.5, 0.25]

    found = found_by(path, arrays)

    assert_allclose(found.confidence, confidence, rtol=1e-5)


@pytest.mark.parametrize("layout", SUPPRESSED + DENSE)
def test_boxes_that_are_hardly_sure_or_outside_the_image_are_dropped(path, layout):
    outside = [-20.0, 3.0, -2.0, 9.0]
    cut = [50.0, 50.0, 80.0, 90.0]

    arrays = layout([PERSON, outside, cut], [0, 0, 0], [0.01, 0.9, 0.8])
    found = found_by(path, arrays)

    assert_allclose(found.boxes_px, [[50.0, 50.0, 64.0, 64.0]], atol=1e-4)


@pytest.mark.parametrize("layout", [as_torchvision, as_retinanet])
def test_an_image_without_anything_has_no_boxes(path, layout):
    nothing = layout([], [], [])
    found = found_by(path, nothing)
    pedestrians = boxes_of_class(found, "pedestrian")[0]
    cyclists = boxes_of_class(found, "cyclist")[0]

    assert found.boxes_px.shape == (0, 4)
    assert len(found.class_ids) == len(found.confidence) == 0
    assert pedestrians.shape == (0, 4)
    assert cyclists.shape == (0, 4)


def test_masks_beside_boxes_labels_and_scores_are_left_alone(path):
    masks = np.zeros((1, 1, 28, 28), dtype=np.float32)
    found = found_by(path, ONE_PERSON | {"masks": masks})

    assert_allclose(found.boxes_px, [PERSON])


# What the network is shown, and the way back.


@pytest.mark.parametrize("takes", [FREE, "float[1, 3, 70, 90] images"])
def test_an_image_of_the_right_or_a_free_size_is_shown_as_it_is(path, takes):
    found = load_onnx_model(save_bright(path, takes)).detect(
        picture(90, 70, (11, 13, 37, 41))
    )
    assert found.boxes_px.tolist() == [[11.0, 13.0, 37.0, 41.0]]


def test_an_input_without_batch_takes_the_image_alone(path):
    found = found_by(path, ONE_PERSON, takes="float[3, height, width] image")
    assert_allclose(found.boxes_px, [PERSON])


@pytest.mark.parametrize(
    ("kind", "threshold"),
    [
        ("float16", 0.999),
        ("uint8", 254.5),
    ],
)
def test_inputs_may_be_half_floats_or_bytes(path, kind, threshold):
    takes = FREE.replace("float", kind)
    saved = save_bright(path, takes, threshold)
    model = load_onnx_model(saved)
    image = picture(90, 70, (11, 13, 37, 41))
    found = model.detect(image)

    assert found.boxes_px.tolist() == [[11.0, 13.0, 37.0, 41.0]]


def test_letterbox_goes_back_by_the_scale_of_whole_pixels():
    # 30 x 50 into 64 x 64: scale 1.28, 38.4 columns become 38; 13 columns of grey on
    # each side.
    fitted = letterbox(
        np.zeros((50, 30, 3), dtype=np.uint8),
        width_px=64,
        height_px=64,
        scale=1.28,
    )
    assert (fitted.pixels[0, :, 0] == [114] * 13 + [0] * 38 + [114] * 13).all()
    assert_allclose(
        fitted.to_image(np.array([[13.0, 0.0, 51.0, 64.0], [32.0, 32.0, 51.0, 64.0]])),
        [[0.0, 0.0, 30.0, 50.0], [15.0, 25.0, 30.0, 50.0]],
    )


def test_an_image_of_free_size_is_padded_to_yolos_grid(path):
    """50 x 40 becomes 64 x 64: 7 columns and 12 rows before it. An end-to-end table of
    one box, whose score is the image's width in hundreds of pixels.
    """
    graph = f"""({FREE}) => (float[] output0)
    <float[1] hundred = {{100.0}}, float[4] box = {{7.0, 12.0, 32.0, 52.0}},
    float[1] class = {{0.0}}, int64[3] size = {{1, 1, 6}}> {{
        shape = Shape<start = 3, end = 4>(images)
        width = Cast<to = 1>(shape)
        score = Div(width, hundred)
        row = Concat<axis = 0>(box, score, class)
        output0 = Reshape(row, size)
    }}"""
    found = load_onnx_model(save(path, graph)).detect(
        np.zeros((40, 50, 3), dtype=np.uint8)
    )

    assert_allclose(found.confidence, [0.64])
    assert_allclose(found.boxes_px, [[0.0, 0.0, 25.0, 40.0]])


@pytest.mark.parametrize("size", ["32, width", "height, 64"])
def test_an_input_of_one_fixed_side_takes_the_image_scaled_to_it(path, size):
    model = load_onnx_model(save_bright(path, f"float[1, 3, {size}] images"))
    image = picture(128, 64, (20, 10, 60, 40))
    found = model.detect(image)

    assert_allclose(found.boxes_px, [[20.0, 10.0, 60.0, 40.0]])


@pytest.mark.parametrize(
    ("n_classes", "expected"),
    [
        (91, (1.0 - 0.485) / 0.229),
        (80, 1.0),
    ],
)
def test_detr_with_91_classes_sees_the_image_by_imagenets_mean_and_spread(
    path, n_classes, expected
):
    graph = f"""({FIXED}) => (float[] logits, float[] pred_boxes)
    <int64[1] zero = {{0}}, int64[1] one = {{1}}, int64[3] size = {{1, 1, {n_classes}}},
    float[1, 1, 4] whole = {{0.5, 0.5, 1.0, 1.0}}> {{
        red = Slice(images, zero, one, one)
        brightest = ReduceMax<axes = [1, 2, 3], keepdims = 0>(red)
        logits = Expand(brightest, size)
        pred_boxes = Identity(whole)
    }}"""
    model = load_onnx_model(save(path, graph))
    found = model.detect(np.full((64, 64, 3), 255, dtype=np.uint8))
    odds = np.exp(-expected)

    assert_allclose(found.confidence, [1.0 / (1.0 + odds)], rtol=1e-5)


def test_the_size_that_rt_detr_asks_for_is_that_of_the_letterbox(path):
    graph = f"""({FIXED}, int64[1, 2] orig_target_sizes)
    => (int64[] labels, float[] boxes, float[] scores)
    <float[1, 2] origin = {{0.0, 0.0}}, int64[3] shape = {{1, 1, 4}},
    int64[1, 1] person = {{0}}, float[1, 1] half = {{0.5}}> {{
        size = Cast<to = 1>(orig_target_sizes)
        box = Concat<axis = 1>(origin, size)
        boxes = Reshape(box, shape)
        labels = Identity(person)
        scores = Identity(half)
    }}"""
    model = load_onnx_model(save(path, graph))
    black = np.zeros((50, 100, 3), dtype=np.uint8)
    found = model.detect(black)

    assert_allclose(found.boxes_px, [[0.0, 0.0, 100.0, 50.0]])
    assert found.kinds == COCO80


def test_the_mask_that_detr_asks_for_is_given(path):
    takes = "float[1, 3, 64, 64] pixel_values, int64[1, 64, 64] pixel_mask"
    arrays = as_detr([PERSON], [0], [0.5])
    found = found_by(path, arrays, takes=takes)

    assert_allclose(found.boxes_px, [PERSON], atol=1e-4)


# Classes.

COCO80 = {
    0: "person",
    1: "bicycle",
    2: "car",
    3: "motorcycle",
}


@pytest.mark.parametrize(
    ("names", "kinds"),
    [
        (
            "{0: 'Car', 1: 'Pedestrian', 2: 'Cyclist'}",
            {0: "car", 1: "person", 2: "cyclist"},
        ),
        ("['bike', 'person']", {0: "bicycle", 1: "person"}),
    ],
)
def test_names_in_the_file_come_first(path, names, kinds):
    found = found_by(path, ONE_PERSON, metadata={"names": names})
    assert found.kinds == kinds


def test_names_that_are_but_numbers_count_as_none(path):
    # What Ultralytics 8.4.190 writes for a network that was built without names.
    names = str({number: str(number) for number in range(80)})
    arrays = as_yolov8([PERSON], [0], [0.75])
    found = found_by(path, arrays, metadata={"names": names})

    assert found.kinds == COCO80


def test_names_tell_the_number_of_classes_of_a_table(path):
    metadata = {"names": "{0: 'cyclist', 1: 'person', 2: 'dog'}"}
    scores = [[0.1, 0.75, 0.2], [0.5, 0.1, 0.2]]

    boxes = centred([PERSON, BICYCLE])
    dense = f32(boxes, scores)
    arrays = {"output0": dense.T[None]}
    found = found_by(path, arrays, metadata=metadata)

    assert found.class_ids.tolist() == [1, 0]
    assert_allclose(found.boxes_px, [PERSON, BICYCLE])


# Cyclists.


def image_boxes(*rows):
    """Boxes of rows (box, class, confidence)."""
    boxes, ids, confidence = zip(*rows, strict=True)
    return ImageBoxes(
        boxes_px=np.array(boxes, dtype=float),
        class_ids=np.array(ids),
        confidence=np.array(confidence),
        kinds={
            1: "person",
            2: "bicycle",
            3: "cyclist",
            4: "motorcycle",
            5: "car",
        },
    )


def test_a_cyclist_is_a_person_and_a_bicycle_that_overlap_or_either():
    found = image_boxes(
        ([10.0, 0.0, 20.0, 30.0], 1, 0.9),  # rides
        ([100.0, 0.0, 110.0, 30.0], 1, 0.8),  # walks
        ([5.0, 15.0, 35.0, 40.0], 2, 0.7),  # is ridden
        ([50.0, 10.0, 60.0, 20.0], 3, 0.6),
        ([70.0, 10.0, 80.0, 20.0], 9, 0.5),  # a dog
    )

    persons, how_sure = boxes_of_class(found, "pedestrian")
    first_two = found.boxes_px[:2].tolist()

    assert persons.tolist() == first_two
    assert how_sure.tolist() == [0.9, 0.8]

    cyclists, how_sure = boxes_of_class(found, "cyclist")

    assert sorted(zip(cyclists.tolist(), how_sure, strict=True)) == sorted(
        [
            ([5.0, 0.0, 35.0, 40.0], 0.7),  # both together, as sure as the less sure
            ([10.0, 0.0, 20.0, 30.0], 0.9),
            ([100.0, 0.0, 110.0, 30.0], 0.8),
            ([5.0, 15.0, 35.0, 40.0], 0.7),
            ([50.0, 10.0, 60.0, 20.0], 0.6),
        ]
    )


def test_a_motorcyclist_is_put_together_as_a_cyclist_is_and_counts_for_none():
    found = image_boxes(
        ([10.0, 0.0, 20.0, 30.0], 1, 0.9),  # rides the motorcycle
        ([5.0, 15.0, 35.0, 40.0], 4, 0.7),
        ([50.0, 10.0, 60.0, 20.0], 2, 0.6),  # a bicycle
        ([70.0, 10.0, 90.0, 20.0], 5, 0.5),
    )

    motorcyclists, how_sure = boxes_of_class(found, "motorcyclist")

    assert motorcyclists.tolist() == [
        [5.0, 0.0, 35.0, 40.0],
        [10.0, 0.0, 20.0, 30.0],
        [5.0, 15.0, 35.0, 40.0],
    ]
    assert how_sure.tolist() == [0.7, 0.9, 0.7]
    assert boxes_of_class(found, "cyclist")[1].tolist() == [0.9, 0.6]
    assert boxes_of_class(found, "car")[0].tolist() == [[70.0, 10.0, 90.0, 20.0]]

    for name in ("pedestrian", "child"):
        boxes = boxes_of_class(found, name)
        assert boxes[0].tolist() == [[10.0, 0.0, 20.0, 30.0]]


def test_a_bicycle_that_only_touches_a_person_is_not_ridden():
    found = image_boxes(
        ([10.0, 0.0, 20.0, 30.0], 1, 0.9), ([20.0, 0.0, 40.0, 30.0], 2, 0.7)
    )
    cyclists = boxes_of_class(found, "cyclist")[0]
    assert len(cyclists) == 2


@given(
    st.lists(st.tuples(boxes_px(), st.integers(0, 2)), max_size=12),
    st.sampled_from([0.0, 0.3, 0.5, 0.9]),
)
def test_suppression_keeps_what_brute_force_keeps(rows, max_iou):
    boxes_given = [box for box, _ in rows]
    boxes = np.array(boxes_given).reshape(-1, 4)
    ids_given = [number for _, number in rows]
    ids = np.array(ids_given, dtype=np.int64)
    kept = []
    for i in range(len(rows)):
        if not any(
            ids[i] == ids[j] and iou(boxes[i], boxes[j]) > max_iou for j in kept
        ):
            kept.append(i)

    suppressed = suppress(boxes, ids, max_iou=max_iou)

    assert suppressed.tolist() == kept


# What users do.


def message_of(path):
    """Words in which a network is refused, in one line."""
    with pytest.raises(InputError) as caught:
        load_onnx_model(path)

    text = str(caught.value)

    assert "\n" not in text
    assert text.startswith(f"{path}: got ")

    return text.removeprefix(f"{path}: got ")


def test_a_file_that_is_missing(path):
    assert message_of(path) == "no such file; expected an ONNX file"


@pytest.mark.parametrize("content", [b"", b"no network", b"\x08\x09\x12\xff\xff\xff"])
def test_a_file_that_is_not_onnx(path, content):
    path.write_bytes(content)
    assert message_of(path).endswith("; expected an ONNX file")


def test_a_classifier(path):
    arrays = {"logits": np.zeros((1, 1000), dtype=np.float32)}
    save_constants(path, arrays)
    text = message_of(path)

    assert text.startswith(
        "outputs logits (1, 1000); expected a detector's outputs: boxes (n, 4),"
    )


@pytest.mark.parametrize(
    "arrays",
    [
        {
            "output0": np.zeros((1, 116, 50), np.float32),
            "output1": np.zeros((1, 32, 8, 8), "f"),
        },
        {"output0": np.zeros((1, 21, 64, 64), np.float32)},  # segments
        {"output0": np.zeros((2, 84, 50), np.float32)},  # two images
        {
            "a": np.zeros((5, 4), "f"),
            "b": np.zeros(5, "f"),
            "c": np.zeros(5, "f"),
        },
        {"logits": np.zeros((1, 9, 20), "f"), "pred_boxes": np.zeros((1, 9, 4), "f")},
    ],
)
def test_networks_with_other_outputs(path, arrays):
    text = message_of(save_constants(path, arrays))
    assert text.startswith("outputs " + next(iter(arrays)))


@pytest.mark.parametrize(
    "takes",
    [
        "float[1, 3, 64, 64] left, float[1, 3, 64, 64] right",
        "int64[1, 128] tokens",
        "float[1, 64, 64, 3] images",
        "float[8, 3, 64, 64] images",
        "int64[1, 3, 64, 64] images",
    ],
)
def test_networks_with_other_inputs(path, takes):
    arrays = as_yolov8([PERSON], [0], [0.75])
    save_constants(path, arrays, takes=takes)
    text = message_of(path)

    assert re.match(r"inputs (left|tokens|images) tensor\(", text)
    assert text.endswith(
        "; expected one image input, (1, 3, height, width) or (3, height, width), RGB"
    )


def test_a_network_that_does_not_run(path):
    graph = f"""({FREE}) => (float[] output0) <int64[3] size = {{1, 7, 13}}> {{
        output0 = Reshape(images, size)
    }}"""
    save(path, graph)

    assert message_of(path).endswith("; expected a network that runs")


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        ("person", "a dictionary from number to name"),
        ("{'person': 0}", "a dictionary from number to name"),
        (
            "{0: 'cat'}",
            (
                "among them one of bicycle, bicyclist, bike, car, cyclist, motorbike,"
                " motorcycle, motorcyclist, pedestrian, people, person, rider"
            ),
        ),
    ],
)
def test_names_that_say_nothing(path, names, expected):
    with refused_with(f"{path}: metadata 'names': got {names!r}; expected {expected}"):
        found_by(path, ONE_PERSON, metadata={"names": names})


def test_boxes_that_are_not_numbers(path):
    arrays = as_torchvision([[np.nan, 0.0, 1.0, 1.0]], [0], [0.75])

    with pytest.raises(
        InputError, match="got a box that is not a number; expected finite boxes"
    ):
        found_by(path, arrays)


@pytest.mark.parametrize(
    "image",
    [np.zeros((4, 4), np.uint8), np.zeros((4, 4, 3)), np.zeros((0, 4, 3), np.uint8)],
)
def test_images_that_are_none(path, image):
    with pytest.raises(
        InputError, match=r"expected uint8 of shape \(height, width, 3\)"
    ):
        found_by(path, ONE_PERSON, image)


def test_the_extra_is_named_where_onnxruntime_is_missing(path, monkeypatch):
    save_constants(path, ONE_PERSON)
    monkeypatch.setitem(sys.modules, "onnxruntime", None)

    with pytest.raises(MissingExtraError, match="uv run --extra perception"):
        load_onnx_model(path)
