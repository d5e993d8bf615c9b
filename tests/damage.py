"""Damaged files: bytes of a sound one cut, overwritten, doubled."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from geometry.errors import InputError

_TEXTS = [b"", b"0", b"-1", b"NaN", b"1e999", b"99999999999999999999", b"[", b"{}", b"null", b"\0"]


@st.composite
def damaged(draw: st.DrawFn, sound: bytes) -> bytes:
    """A file with up to four wounds."""
    data = sound
    for _ in range(draw(st.integers(1, 4))):
        first = draw(st.integers(0, max(0, len(data) - 1)))
        last = min(len(data), first + draw(st.sampled_from([0, 1, 2, 4, 8, 50, 100_000])))
        piece = draw(
            st.one_of(
                st.sampled_from(_TEXTS),
                st.binary(min_size=last - first, max_size=last - first)
                if last - first < 50
                else st.just(b""),
                st.just(data[first:last] * 2),
            )
        )
        data = data[:first] + piece + data[last:]
    return data


def read_or_refuse(path: Path, data: bytes, read: Callable[[Path], Any]) -> Any:
    """What a reader makes of bytes; None if it refuses them in one line that names the file."""
    path.write_bytes(data)
    refused: InputError | None = None
    try:
        return read(path)
    except InputError as error:
        refused = error
    assert "\n" not in str(refused)
    return None
