"""Which sets are equal, and which are part of another: by hashes, signatures, rarest members.

Sets are the rows of a compressed sparse matrix, their members its columns, ascending.
"""

from collections.abc import Iterator

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from geometry.arrays import FloatArray, IntArray

WordArray = NDArray[np.uint64]

_MAX_WORDS = 64  # 4,096 bits to a signature: exact for so many members, a sieve for more
_BLOCK_BYTES = 1 << 25
_FIRST_WORDS = 4
_SEED = 20  # of the hashes; equal sets are equal whatever it is


def first_equal(sets: sp.csr_array) -> IntArray:
    """For every set, the first one with the same members.

    Parameters
    ----------
    sets : (n_sets, n_members) sparse
        Sets, as rows.

    Returns
    -------
    first : (n_sets,) int
        An index of `sets`, at most its own.
    """
    n_sets = sets.shape[0]
    rng = np.random.default_rng(_SEED)
    hashes = rng.integers(np.iinfo(np.uint64).max, size=(2, sets.shape[1]), dtype=np.uint64)
    sums = np.zeros((2, sets.indices.size + 1), dtype=np.uint64)
    np.cumsum(hashes[:, sets.indices], axis=1, out=sums[:, 1:])
    keys = (sums[:, sets.indptr[1:]] - sums[:, sets.indptr[:-1]]).T  # modulo 2^64
    size = np.diff(sets.indptr).astype(np.uint64)
    _, first, group = np.unique(
        np.column_stack([size, keys]), axis=0, return_index=True, return_inverse=True
    )
    first_of: IntArray = first[group.ravel()].astype(np.int64)
    # A hash is no proof: a set whose members turn out to differ stands for itself.
    members = _members_of(sets, first_of)
    differs = np.zeros(sets.indices.size + 1, dtype=np.int64)
    np.cumsum(members != sets.indices, out=differs[1:])
    is_same = differs[sets.indptr[1:]] == differs[sets.indptr[:-1]]
    return np.where(is_same, first_of, np.arange(n_sets))


def supersets(
    sets: sp.csr_array, price: FloatArray, *, max_work: float
) -> Iterator[tuple[int, IntArray]]:
    """For every set, the larger sets at no higher price of which it is a part.

    Parameters
    ----------
    sets : (n_sets, n_members) sparse
        Sets, as rows; no two are equal, none is empty.
    price : (n_sets,) float
        A set is only compared with sets that cost no more.
    max_work : float
        Give up after so many comparisons of pairs, the ones with fewest candidates first.

    Yields
    ------
    part : int
        A set.
    wholes : (n,) int
        Sets that contain it; at least one.

    Notes
    -----
    A whole has all members of its part, the rarest among them: only sets with that one are
    compared, by signatures. Where there are more members than bits the signature is a sieve, and
    what passes is compared member by member.
    """
    n_sets, n_members = sets.shape
    if n_sets == 0:
        return
    size = np.diff(sets.indptr)
    by_member = sets.T.tocsr()
    frequency = np.diff(by_member.indptr)
    rarest = _rarest_members(sets, frequency)
    words = _signatures(sets)
    is_exact = n_members <= 64 * words.shape[1]
    for part in np.argsort(frequency[rarest], kind="stable"):
        start, end = by_member.indptr[rarest[part]], by_member.indptr[rarest[part] + 1]
        max_work -= end - start
        if max_work < 0.0:
            return
        wholes: IntArray = by_member.indices[start:end].astype(np.int64)
        wholes = wholes[(size[wholes] > size[part]) & (price[wholes] <= price[part])]
        for some in (slice(0, _FIRST_WORDS), slice(_FIRST_WORDS, None)):  # few pass the first
            if len(wholes) and words[part, some].any():
                wholes = wholes[~(words[part, some] & ~words[wholes, some]).any(axis=1)]
        if len(wholes) and not is_exact:
            wholes = _containing(sets, _row(sets, part), wholes)
        if len(wholes):
            yield int(part), wholes


def _row(sets: sp.csr_array, row: int) -> IntArray:
    return sets.indices[sets.indptr[row] : sets.indptr[row + 1]].astype(np.int64)


def _members_of(sets: sp.csr_array, rows: IntArray) -> IntArray:
    """Members of each row named, as many as the set in that place has, all in a line."""
    size = np.diff(sets.indptr)
    offset = np.arange(sets.indices.size) - np.repeat(sets.indptr[:-1], size)
    members: IntArray = sets.indices[np.repeat(sets.indptr[rows], size) + offset]
    return members


def _rarest_members(sets: sp.csr_array, frequency: IntArray) -> IntArray:
    """The member of each set that is in fewest sets, (n_sets,)."""
    n_members = np.int64(sets.shape[1])
    keys = frequency[sets.indices].astype(np.int64) * n_members + sets.indices
    rarest: IntArray = np.minimum.reduceat(keys, sets.indptr[:-1]) % n_members
    return rarest


def _signatures(sets: sp.csr_array) -> WordArray:
    """One bit per member, or several members to a bit, (n_sets, n_words)."""
    n_sets, n_members = sets.shape
    n_words = min(-(-n_members // 64), _MAX_WORDS)
    words = np.empty((n_sets, n_words), dtype=np.uint64)
    block = max(1, _BLOCK_BYTES // (64 * n_words))
    for start in range(0, n_sets, block):
        end = min(start + block, n_sets)
        members = sets.indices[sets.indptr[start] : sets.indptr[end]]
        rows = np.repeat(np.arange(end - start), np.diff(sets.indptr[start : end + 1]))
        bits = np.zeros((end - start, 64 * n_words), dtype=np.bool_)
        bits[rows, members % (64 * n_words)] = True
        words[start:end] = np.packbits(bits, axis=1, bitorder="little").view(np.uint64)
    return words


def _containing(sets: sp.csr_array, members: IntArray, candidates: IntArray) -> IntArray:
    """Those candidates that have all the members."""
    is_member = np.zeros(sets.shape[1], dtype=np.bool_)
    is_member[members] = True
    return np.array(
        [
            candidate
            for candidate in candidates
            if np.count_nonzero(is_member[_row(sets, candidate)]) == len(members)
        ],
        dtype=np.int64,
    )
