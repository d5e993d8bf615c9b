"""Damaged files: bytes of a sound one cut, overwritten, doubled; also inside
archives.
"""

import io
import json
import random
import re
import zipfile
from typing import Any

from hypothesis import strategies as st

_TEXTS = [
    b"",
    b"0",
    b"-1",
    b"NaN",
    b"1e999",
    b"99999999999999999999",
    b"[",
    b"{}",
    b"null",
    b"\0",
]
_LENGTHS = [0, 1, 2, 4, 8, 50, 100_000]


@st.composite
def damaged(draw: st.DrawFn, sound: bytes) -> bytes:
    """A file with up to four wounds."""
    data = sound
    for _ in range(draw(st.integers(1, 4))):
        first = draw(st.integers(0, max(0, len(data) - 1)))
        last = min(len(data), first + draw(st.sampled_from(_LENGTHS)))
        piece = draw(
            st.one_of(
                st.sampled_from(_TEXTS),
                (
                    st.binary(min_size=last - first, max_size=last - first)
                    if last - first < 50
                    else st.just(b"")
                ),
                st.just(data[first:last] * 2),
            )
        )
        data = data[:first] + piece + data[last:]

    return data


# ---------- many wounds in a second, drawn by a generator: for the fuzz tests

_WORDS = [
    *_TEXTS,
    *(
        b"1e308",
        b"-1e308",
        b"1e-308",
        b"inf",
        b"-0",
        b"0.5",
        b"1e400",
        b"true",
        b'""',
        b"[]",
    ),
    *(
        b"9" * 400,
        b"2147483648",
        b"-9223372036854775809",
        b"4294967296",
        b"1e9",
        b"1000000",
    ),
    *(
        b"\xff\xfe",
        b"\xc3\x28",
        b"\xed\xa0\x80",
        "ü".encode(),
        b"\n",
        b"\r\n",
        b"=1+1",
        b"../x",
    ),
    *(
        b"[" * 5000,
        b'{"a":' * 5000,
        b"((((",
        b"-",
        b"+",
        b"%s",
        b"{0}",
        b"&lt;",
        b"<a>",
        b"</a>",
    ),
]
_NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
_EDGES = [
    0,
    1,
    0x7F,
    0x80,
    0xFF,
    0x7FFF,
    0x8000,
    0xFFFF,
    0x7FFFFFFF,
    0x80000000,
    0xFFFFFFFF,
]
_VALUES: list[Any] = [
    *(
        None,
        True,
        False,
        0,
        -1,
        1,
        10**9,
        10**400,
        1.5,
        1e308,
        -1e308,
        float("nan"),
        float("inf"),
    ),
    *(
        "",
        "a",
        "NaN",
        "\0",
        "\ud800",
        "x" * 10_000,
        "../../x",
        "=1+1",
        [],
        {},
        [[]],
        [{}],
        [None],
    ),
    *({"a": 1}, [1e308] * 3, ["a"], [0] * 1000),
]


def wounded(rng: random.Random, data: bytes, name: str = "") -> bytes:
    """A damaged file; `name` says by its ending what kind of file it is.

    Of archives sometimes what they hold is damaged and packed again, so that checksums
    are right. Of JSON sometimes a value is replaced by another kind of value.
    """
    for _ in range(rng.choice([1, 1, 1, 2, 4])):
        kind = rng.random()
        if data[:2] == b"PK" and kind < 0.8:
            data = _inside(rng, data)
        elif name.endswith(("json", ".gltf")) and kind < 0.5:
            data = _other_value(rng, data)
        elif (
            kind < 0.7
            and len(numbers := list(_NUMBER.finditer(data, 0, 1_000_000))) > 1
        ):
            at = rng.choice(numbers)
            data = (
                data[: at.start()]
                + rng.choice([*_WORDS, *_plain_numbers(rng)])
                + data[at.end() :]
            )
        elif kind < 0.8 and data.count(b"\n") > 1:
            data = _other_lines(rng, data)
        elif kind < 0.9 and len(data) > 8:
            data = _other_integer(rng, data)
        else:
            if data:
                first = rng.randrange(len(data))
            else:
                first = 0
            last = min(len(data), first + rng.choice(_LENGTHS))
            piece = rng.choice(
                [*_WORDS, rng.randbytes(min(50, last - first)), data[first:last] * 2]
            )
            data = data[:first] + piece + data[last:]

    return data


def _plain_numbers(rng: random.Random) -> list[bytes]:
    """Numbers as text: one at an edge, any one, and two plain ones."""
    return [
        str(rng.choice(_EDGES)).encode(),
        repr(rng.uniform(-1e6, 1e6)).encode(),
        b"0.0",
        b"1",
    ]


def _inside(rng: random.Random, data: bytes) -> bytes:
    """An archive one of whose files is damaged, missing, or under another's name."""
    packed = io.BytesIO()
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    except Exception:  # it has been damaged before
        return data[: len(data) // 2]
    if not members:
        return b""
    name = rng.choice(list(members))
    match rng.randrange(10):
        case 0:
            del members[name]
        case 1:
            members[rng.choice(list(members))] = members[name]
        case _:
            members[name] = wounded(rng, members[name], name)
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return packed.getvalue()


def _other_value(rng: random.Random, data: bytes) -> bytes:
    """JSON with another value somewhere, or a key missing."""
    try:
        document = json.loads(data)
    except (ValueError, RecursionError):
        return data[: len(data) // 2]
    places: list[tuple[Any, Any]] = []
    if isinstance(document, dict | list):
        nodes = [document]
    else:
        nodes = []

    for node in nodes:  # grows while it is walked through
        if isinstance(node, dict):
            items = node.items()
        else:
            items = enumerate(node)
        for key, value in list(items):
            places.append((node, key))
            if isinstance(value, dict | list):
                nodes.append(value)
        if len(places) > 5000:
            break

    if not places:
        return b"null"
    node, key = rng.choice(places)
    if rng.random() < 0.2:
        del node[key]
    else:
        node[key] = rng.choice([*_VALUES, rng.choice(places)[0]])
    try:
        return json.dumps(document).encode("utf-8", "surrogatepass")
    except ValueError:  # it holds itself now
        return b"[" * 1000


def _other_lines(rng: random.Random, data: bytes) -> bytes:
    """Text with a line missing, doubled, or at another place."""
    lines = data.split(b"\n")
    first = rng.randrange(len(lines))
    second = rng.randrange(len(lines))
    match rng.randrange(4):
        case 0:
            del lines[first]
        case 1:
            lines.insert(second, lines[first])
        case 2:
            lines[first], lines[second] = lines[second], lines[first]
        case _:
            lines[first] = rng.choice(_WORDS)
    return b"\n".join(lines)


def _other_integer(rng: random.Random, data: bytes) -> bytes:
    """Binary data with another number of 1, 2, 4 or 8 bytes; more often near the
    beginning.
    """
    size = rng.choice([1, 2, 4, 8])
    if rng.random() < 0.4:
        reach = len(data) - size
    else:
        reach = min(len(data) - size, 400)
    at = rng.randint(0, max(0, reach))
    value = rng.choice([*_EDGES, rng.getrandbits(8 * size)]) & ((1 << 8 * size) - 1)
    return (
        data[:at]
        + value.to_bytes(size, rng.choice(["little", "big"]))
        + data[at + size :]
    )
