"""Bits of the player, as its script reads them."""

import base64

import numpy as np


def unpack_bits(text, *, n_rows, n):
    """Rows of bits, (n_rows, n), from `experiments.parts.player.pack_bits`."""
    data = np.frombuffer(base64.b64decode(text), dtype=np.uint8).reshape(n_rows, -1)
    return np.unpackbits(
        data,
        axis=1,
        count=n,
    ).astype(bool)
