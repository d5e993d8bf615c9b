"""JSON of others: read in one way only, and in one place."""

import re
from pathlib import Path

import pytest

from geometry.errors import InputError
from geometry.text_formats import parse_json

PRODUCT = ("geometry", "scenarios", "placement", "experiments")
READS_JSON = re.compile(
    r"\bjson\.loads?\(|msgspec\.json\.(?:decode|Decoder)\(|JSONDecoder\("
)
# What these read is text that this program, or one that it has begun, has just written.
OWN_TEXT = {
    "geometry/text_formats.py",  # the one place
    "experiments/bench/main_job.py",
    "experiments/bench/work.py",
    "experiments/engine/start.py",
    "experiments/export/uper.py",
    "experiments/planner/numbers.py",
    "experiments/planner/page_files.py",
    "experiments/planner/plan_files.py",
    "experiments/planner/server.py",
    "experiments/results/record.py",
    "placement/sampling/moving/child.py",
}


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ('{"a": 1, "a": 1}', "a"),
        ('{"a": {"b": [{"c": 1, "c": 2}]}}', "c"),
        ('[{}, {"": null, "": null}]', ""),
        ('{"stages": [], "\\u0073tages": [1]}', "stages"),
    ],
)
def test_an_object_with_a_key_twice_is_refused(text, key):
    for document in (text, text.encode()):
        with pytest.raises(InputError) as caught:
            parse_json(document, "here.json", "anything")
        expected = (
            f'here.json: got the key "{key}" twice; expected every key of an object'
            " once"
        )
        assert str(caught.value) == expected


def test_a_key_may_stand_in_several_objects():
    assert parse_json('[{"a": 1}, {"a": {"a": 2}}]', "here", "") == [
        {"a": 1},
        {"a": {"a": 2}},
    ]


def test_a_long_key_that_stands_there_twice_is_shown_in_one_short_line():
    key = "x\\n" * 1000
    with pytest.raises(InputError) as caught:
        parse_json(f'{{"{key}": 1, "{key}": 2}}', "here", "")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    "content", [b"\xff", b"", b"{", b"[1,]", b"[" * 100_000, b"1" * 10_000]
)
def test_what_is_no_json_is_refused_in_one_line(content):
    with pytest.raises(InputError) as caught:
        parse_json(content, "here", "something flat")
    assert "\n" not in str(caught.value)


def test_a_byte_order_mark_is_no_part_of_the_content():
    assert parse_json(b'\xef\xbb\xbf{"a": 1}', "here", "") == {"a": 1}


@pytest.mark.long
def test_no_other_module_reads_json_of_others():
    root = Path(__file__).parents[2]
    readers = {
        path.relative_to(root).as_posix()
        for package in PRODUCT
        for path in (root / package).rglob("*.py")
        if READS_JSON.search(path.read_text(encoding="utf-8"))
    }
    assert readers <= OWN_TEXT
