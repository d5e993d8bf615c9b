"""An image below the plan, such as an aerial one: how it lies, and its message to browsers."""

import math
from typing import Any

import msgspec
from msgspec import Struct

from geometry.errors import InputError, Unquoted, refuse
from geometry.phrases import Phrase
from geometry.text_formats import parse_json

from ..language import mark

MAX_IMAGE_BYTES = 8_000_000
"""Of an image that a browser sends."""

_MAX_SIDE_PX = 30_000
_LEAST_APART_PX = 2.0
_LEAST_APART_M = 0.5
_MAX_COORDINATE_M = 1.0e6
# How the files of the formats begin that browsers draw
_STARTS = {
    b"\x89PNG\r\n\x1a\n": "image/png",
    b"\xff\xd8\xff": "image/jpeg",
    b"GIF8": "image/gif",
}


class LiePoint(Struct, frozen=True, forbid_unknown_fields=True):
    """A place in the image, from its upper left corner, and the same in the world frame."""

    x_px: float
    y_px: float
    east_m: float
    north_m: float


class Lie(Struct, frozen=True, forbid_unknown_fields=True):
    """How an image lies on the plan.

    Two points say it: an image is moved, turned and scaled, not distorted.
    """

    width_px: int
    height_px: int
    points: tuple[LiePoint, LiePoint]


class Background(Struct, frozen=True, forbid_unknown_fields=True):
    """An image, as base64 in a plan's file, and how it lies; nothing here decodes it."""

    lie: Lie
    image: bytes

    @property
    def media_type(self) -> str:
        """Kind of image that browsers draw, by its first bytes; empty: none."""
        if self.image[:4] == b"RIFF" and self.image[8:12] == b"WEBP":
            return "image/webp"
        for start, kind in _STARTS.items():
            if self.image.startswith(start):
                return kind
        return ""


def background_message(background: Background | None) -> dict[str, Any]:
    """Message about the image: its address, size and points; an empty address: none."""
    if background is None:
        return {"type": "background", "address": ""}
    lie = background.lie
    return {
        "type": "background",
        # By its number: another one is not taken from a cache.
        "address": f"background?{id(background)}",
        "size": [lie.width_px, lie.height_px],
        "points": [msgspec.structs.astuple(point) for point in lie.points],
    }


def build_background(content: bytes, lie: bytes, where: str) -> Background:
    """A background from what a browser sends.

    Parameters
    ----------
    content : bytes
        The image.
    lie : bytes
        JSON of its :class:`Lie`.
    where : str
        Name for messages.

    Raises
    ------
    InputError
        It is none that browsers draw, too large, or the points do not lay it.
    """
    expected = mark("two points of the image")
    try:
        document = parse_json(lie, _points_of(where), expected)
        found = msgspec.convert(document, Lie)
    except InputError as error:
        raise InputError(_points_of(where), error.got, expected) from None
    except msgspec.ValidationError as error:
        raise InputError(_points_of(where), Unquoted(error), expected) from None
    return _checked(Background(lie=found, image=content), where)


def read_background(record: Any, where: str) -> Background:
    """A background from the record in a plan's file; InputError as :func:`build_background`."""
    try:
        found = msgspec.convert(record, Background)
    except msgspec.ValidationError as error:
        raise InputError(
            where, Unquoted(error), mark("an image and its position")
        ) from None
    return _checked(found, where)


def _checked(background: Background, where: str) -> Background:
    """The background itself; InputError: browsers do not draw it, or its points do not lay it."""
    lie = background.lie
    n_bytes = len(background.image)
    if n_bytes > MAX_IMAGE_BYTES:
        got = Phrase("{n:,} bytes", n=n_bytes)
        refuse(where, got, Phrase("at most {n:,}", n=MAX_IMAGE_BYTES))
    if not background.media_type:
        refuse(where, mark("another format"), mark("PNG, JPEG, WebP or GIF"))
    is_width_known = 1 <= lie.width_px <= _MAX_SIDE_PX
    is_height_known = 1 <= lie.height_px <= _MAX_SIDE_PX
    if not (is_width_known and is_height_known):
        size = Phrase(
            "{width} by {height} pixels", width=lie.width_px, height=lie.height_px
        )
        refuse(where, size, Phrase("1 to {n:,} pixels", n=_MAX_SIDE_PX))
    first, second = lie.points
    numbers = [*msgspec.structs.astuple(first), *msgspec.structs.astuple(second)]
    # Not a number is no more than anything, and refused here, too.
    if not all(abs(value) <= _MAX_COORDINATE_M for value in numbers):
        expected = Phrase("numbers up to {n:,.0f}", n=_MAX_COORDINATE_M)
        raise InputError(_points_of(where), numbers, expected)
    apart_px = math.hypot(second.x_px - first.x_px, second.y_px - first.y_px)
    apart_m = math.hypot(second.east_m - first.east_m, second.north_m - first.north_m)
    if apart_px < _LEAST_APART_PX or apart_m < _LEAST_APART_M:
        got = Phrase(
            "points {pixels:.1f} px and {metres:.2f} m from each other",
            pixels=apart_px,
            metres=apart_m,
        )
        expected = Phrase(
            "at least {pixels:g} px and {metres:g} m",
            pixels=_LEAST_APART_PX,
            metres=_LEAST_APART_M,
        )
        refuse(_points_of(where), got, expected)
    return background


def _points_of(where: str) -> Phrase:
    """Name of an image's points, for messages."""
    return Phrase("{file}: points", file=Phrase(where))
