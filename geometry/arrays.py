"""Array types and the one check of shape and finiteness."""

import sys
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError, refuse

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

# Arrays of one shape, for values that are read from files: geometry.tables.read_table
# takes the shape from the type. Type checkers see any array, because numpy's own
# functions return such.
if TYPE_CHECKING:
    Point2 = FloatArray
    Point3 = FloatArray
    Points2 = FloatArray
    Segment2 = FloatArray
else:
    Point2 = np.ndarray[tuple[Literal[2]], np.dtype[np.float64]]
    Point3 = np.ndarray[tuple[Literal[3]], np.dtype[np.float64]]
    Points2 = np.ndarray[tuple[int, Literal[2]], np.dtype[np.float64]]
    Segment2 = np.ndarray[tuple[Literal[2], Literal[2]], np.dtype[np.float64]]


def float_array(values: ArrayLike, shape: tuple[int, ...], name: str) -> FloatArray:
    """Read-only float64 copy of `values`: of this shape (-1: any length) and finite.

    Raises
    ------
    InputError
        The shape differs, or a value is not a finite number; `name` says where.

    Examples
    --------
    >>> float_array([1, 2, 3], (3,), "position_m")
    array([1., 2., 3.])
    """
    try:
        array = np.array(values, dtype=np.float64)
    except (
        TypeError,
        ValueError,
        OverflowError,
    ):
        # A whole number of 400 digits overflows.
        raise InputError(name, values, f"numbers of shape {shape}") from None
    if array.ndim != len(shape) or any(
        want not in (-1, have) for want, have in zip(shape, array.shape, strict=True)
    ):
        refuse(name, f"shape {array.shape}", f"shape {shape}")
    if not np.isfinite(array).all():
        raise InputError(name, array.tolist(), "finite numbers")
    array.setflags(write=False)
    return array


def set_arrays(value: object, where: str, **shapes: tuple[int, ...]) -> None:
    """Replace fields of a frozen value by checked copies, see :func:`float_array`."""
    for name, shape in shapes.items():
        array = float_array(getattr(value, name), shape, f"{where}{name}")
        object.__setattr__(value, name, array)


def freeze(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only view of `array`."""
    view = array.view()
    view.setflags(write=False)
    return view


def is_text(array: NDArray[Any]) -> bool:
    """True if an array from a file has texts that Python can read.

    numpy looks at no character itself.
    """
    if array.dtype.kind != "U":
        return False
    if not array.dtype.itemsize or not array.size:
        return True
    native = np.ascontiguousarray(array.astype(array.dtype.newbyteorder("=")))
    return int(native.reshape(-1).view(np.uint32).max()) <= sys.maxunicode
