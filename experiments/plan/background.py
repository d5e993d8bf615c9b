"""An image of one's own below the plan, laid by two points that are known in both."""

import base64
import binascii
import math
from dataclasses import dataclass
from typing import Any

import msgspec
from msgspec import Struct

from geometry.errors import InputError, Unquoted

MAX_BYTES = 8_000_000
_MAX_SIDE_PX = 30_000
_LEAST_APART_PX, _LEAST_APART_M = 2.0, 0.5
_MAX_COORDINATE_M = 1.0e6
_STARTS = {b"\x89PNG\r\n\x1a\n": "image/png", b"\xff\xd8\xff": "image/jpeg", b"GIF8": "image/gif"}


class Point(Struct, frozen=True, forbid_unknown_fields=True):
    """A place in the image, from its upper left corner, and the same in the world frame."""

    x_px: float
    y_px: float
    east_m: float
    north_m: float


class Lie(Struct, frozen=True, forbid_unknown_fields=True):
    """How an image lies on the plan: its size, and two points."""

    width_px: int
    height_px: int
    points: tuple[Point, Point]


class _Record(Struct, frozen=True, forbid_unknown_fields=True):
    """As a plan's file has it."""

    lie: Lie
    image: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Background:
    """An image and how it lies; it is for browsers to draw, and nothing here decodes it."""

    content: bytes
    media_type: str
    lie: Lie

    def record(self) -> dict[str, Any]:
        """It as a plan's file has it."""
        image = base64.b64encode(self.content).decode()
        return {"lie": msgspec.to_builtins(self.lie), "image": image}


def background_message(background: Background | None) -> dict[str, Any]:
    """What browsers are told: where the image is, its size and points; an empty address: none."""
    if background is None:
        return {"type": "background", "address": ""}
    lie = background.lie
    return {
        "type": "background",
        "address": f"background?{id(background)}",  # another one is not taken from a cache
        "size": [lie.width_px, lie.height_px],
        "points": [msgspec.structs.astuple(point) for point in lie.points],
    }


def build_background(content: bytes, lie: bytes, where: str) -> Background:
    """A background from an image and the JSON of its :class:`Lie`.

    Raises InputError if it is none that browsers draw, too large, or the points do not lay it.
    """
    try:
        found = msgspec.json.decode(lie, type=Lie)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{where}: points", Unquoted(error), "two points of the image") from None
    return _checked(content, found, where)


def read_background(record: Any, where: str) -> Background:
    """A background from a plan's file. Raises InputError as :func:`build_background` does."""
    try:
        found = msgspec.convert(record, _Record)
        content = base64.b64decode(found.image, validate=True)
    except (msgspec.ValidationError, binascii.Error, ValueError) as error:
        raise InputError(where, Unquoted(error), "an image and how it lies") from None
    return _checked(content, found.lie, where)


def _checked(content: bytes, lie: Lie, where: str) -> Background:
    if len(content) > MAX_BYTES:
        raise InputError(where, Unquoted(f"{len(content):,} bytes"), f"at most {MAX_BYTES:,}")
    kind = next((kind for start, kind in _STARTS.items() if content.startswith(start)), "")
    if content[:4] == b"RIFF" and content[8:12] == b"WEBP":
        kind = "image/webp"
    if not kind:
        raise InputError(where, Unquoted("another format"), "PNG, JPEG, WebP or GIF")
    if not (1 <= lie.width_px <= _MAX_SIDE_PX and 1 <= lie.height_px <= _MAX_SIDE_PX):
        size = Unquoted(f"{lie.width_px} by {lie.height_px} pixels")
        raise InputError(where, size, f"1 to {_MAX_SIDE_PX:,} pixels")
    first, second = lie.points
    numbers = [value for point in lie.points for value in msgspec.structs.astuple(point)]
    if not all(math.isfinite(value) and abs(value) <= _MAX_COORDINATE_M for value in numbers):
        raise InputError(f"{where}: points", numbers, f"numbers up to {_MAX_COORDINATE_M:,.0f}")
    apart_px = math.hypot(second.x_px - first.x_px, second.y_px - first.y_px)
    apart_m = math.hypot(second.east_m - first.east_m, second.north_m - first.north_m)
    if apart_px < _LEAST_APART_PX or apart_m < _LEAST_APART_M:
        raise InputError(
            f"{where}: points",
            Unquoted(f"points {apart_px:.1f} px and {apart_m:.2f} m from each other"),
            f"at least {_LEAST_APART_PX:g} px and {_LEAST_APART_M:g} m",
        )
    return Background(content=content, media_type=kind, lie=lie)
