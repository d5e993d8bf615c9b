"""Values as text that may stand inside a ``<script>`` of an HTML page."""

import base64
import json
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

_ESCAPES = {"<": "\\u003c", ">": "\\u003e", "&": "\\u0026"}


def to_script_json(value: Any) -> str:
    r"""A value as JSON that no name in it can break out of.

    Parameters
    ----------
    value : dict, list, str, int, float, bool or None
        Whatever JSON can say; no infinities.

    Returns
    -------
    text : str
        ASCII without ``<``, ``>`` and ``&``: U+2028, U+2029 and halves of surrogate pairs are
        escaped, too.

    References
    ----------
    .. [1] WHATWG, "HTML", section 4.12.1.3, "Restrictions for contents of script elements".

    Examples
    --------
    >>> to_script_json({"a": "</script>"})
    '{"a":"\\u003c/script\\u003e"}'
    """
    text = json.dumps(value, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    for sign, escaped in _ESCAPES.items():  # in JSON these stand in texts only
        text = text.replace(sign, escaped)
    return text


def to_base64(array: NDArray[Any]) -> str:
    """Bytes of an array, row by row, in base64."""
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()


def to_plotly_array(values: ArrayLike, kind: str) -> dict[str, str]:
    """An array as plotly.js reads it: kind and little-endian bytes in base64.

    Parameters
    ----------
    values : (n,) array
        Numbers.
    kind : str
        "f4", "u2", "u4" and so on.
    """
    return {"dtype": kind, "bdata": to_base64(np.asarray(values).astype(f"<{kind}"))}


def pack_bits(bits: ArrayLike) -> str:
    """Rows of bits, each padded to whole bytes, the first bit highest, in base64.

    Parameters
    ----------
    bits : (n_rows, n) bool
        What :func:`unpack_bits` and the player's script give back.
    """
    return to_base64(np.packbits(np.asarray(bits, dtype=bool), axis=1))


def unpack_bits(text: str, *, n_rows: int, n: int) -> NDArray[np.bool_]:
    """Rows of bits, (n_rows, n), from :func:`pack_bits`."""
    data = np.frombuffer(base64.b64decode(text), dtype=np.uint8).reshape(n_rows, -1)
    return np.unpackbits(data, axis=1, count=n).astype(bool)
