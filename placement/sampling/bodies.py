"""Bodies of vehicles in files of traffic: of the catalogue by name, or boxes."""

import numpy as np

from geometry.actors import Actor, Shape, pick_actor
from geometry.errors import InputError
from geometry.files import Table, take_number, take_text

_SIZES = ("length_m", "width_m", "height_m")
# Two triangles on each side, outward; corner x + 2 y + 4 z of a box has these bits.
_BOX_TRIANGLES = np.array(
    [
        [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
        [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
    ]
)  # fmt: skip


def read_body(entry: Table, where: str) -> Actor:
    """A vehicle by a table's `actor`, or a box by `name`, `length_m`, `width_m` and `height_m`.

    Raises InputError for any other key, or a body of the catalogue that is no vehicle.
    """
    known = ("actor",) if "actor" in entry else ("name", *_SIZES)
    for key in entry:
        if key not in known:
            raise InputError(where, key, "one of " + ", ".join(known))
    if "actor" in entry:
        actor = pick_actor(take_text(entry, "actor", where), f"{where}.actor")
        if actor.class_name != "parked vehicle":
            raise InputError(f"{where}.actor", actor.name, "a parked vehicle")
        return actor
    length_m, width_m, height_m = (take_number(entry, key, where) for key in _SIZES)
    try:
        return build_box(
            take_text(entry, "name", where), length_m=length_m, width_m=width_m, height_m=height_m
        )
    except InputError as error:
        raise InputError(f"{where}: {error.where}", error.got, error.expected) from None


def build_box(name: str, *, length_m: float, width_m: float, height_m: float) -> Actor:
    """A vehicle as a box that reaches down to the road."""
    bits = np.array([[index & 1, index >> 1 & 1, index >> 2] for index in range(8)])
    corners = (bits - [0.5, 0.5, 0.0]) * [length_m, width_m, height_m]
    return Actor(
        name=name,
        class_name="parked vehicle",
        length_m=length_m,
        width_m=width_m,
        height_m=height_m,
        shapes=(Shape(vertices_m=corners, triangles=_BOX_TRIANGLES),),
    )
