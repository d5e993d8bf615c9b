"""Piecewise cubic polynomials along a road: offsets, widths, elevations."""

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np

from ...arrays import FloatArray
from .attributes import numbered, take_number


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PiecewiseCubic:
    """a + b ds + c ds^2 + d ds^3 with ds counted from where a piece begins; 0 before the first.

    Attributes
    ----------
    starts_m : (n,) float
        Where the pieces begin, ascending. [m]
    coefficients : (n, 4) float
        a, b, c, d.
    """

    starts_m: FloatArray
    coefficients: FloatArray

    def rebased(self, starts_m: FloatArray, inside_m: FloatArray) -> FloatArray:
        """Coefficients counted from other points.

        Parameters
        ----------
        starts_m : (k,) float
            From which to count. [m]
        inside_m : (k,) float
            Points that say which piece is meant: where two meet, the one or the other. [m]

        Returns
        -------
        coefficients : (k, 4) float
            Of the same polynomials (Taylor's shift).
        """
        if not len(self.starts_m):
            return np.zeros((len(starts_m), 4))
        piece = np.searchsorted(self.starts_m, inside_m, side="right") - 1
        a, b, c, d = self.coefficients[np.maximum(piece, 0)].T
        h = starts_m - self.starts_m[np.maximum(piece, 0)]
        shifted = np.stack(
            [
                a + h * (b + h * (c + h * d)),
                b + h * (2.0 * c + 3.0 * h * d),
                c + 3.0 * h * d,
                d,
            ],
            axis=1,
        )
        return np.where((piece >= 0)[:, None], shifted, 0.0)

    def at(self, s_m: FloatArray) -> FloatArray:
        """Values, (k,)."""
        values: FloatArray = self.rebased(s_m, s_m)[:, 0]
        return values


def evaluate(coefficients: FloatArray, ds_m: FloatArray) -> FloatArray:
    """Values of one cubic per point, (n,): coefficients (n, 4) at ds_m (n,)."""
    a, b, c, d = coefficients.T
    values: FloatArray = a + ds_m * (b + ds_m * (c + ds_m * d))
    return values


def read_cubics(
    parent: Element | None, tag: str, where: str, *, start_key: str = "s", first_m: float = 0.0
) -> PiecewiseCubic:
    """Read a list of elements with attributes a, b, c, d.

    Parameters
    ----------
    parent : Element, optional
        Who has them; none: no pieces.
    tag : str
        Of the elements.
    where : str
        For messages.
    start_key : str
        Attribute that says where a piece begins.
    first_m : float
        Where that counts from. [m]

    Returns
    -------
    cubic : PiecewiseCubic
        In ascending order; of several that begin at one point the last one holds.

    Raises
    ------
    InputError
        A number is missing or not finite.
    """
    rows = [
        (
            first_m + take_number(element, start_key, here),
            *(take_number(element, key, here) for key in "abcd"),
        )
        for element, here in numbered(parent, tag, where)
    ]
    return build_cubics(rows)


def build_cubics(rows: Sequence[tuple[float, ...]]) -> PiecewiseCubic:
    """From rows of start, a, b, c, d."""
    table = np.array(sorted(rows, key=lambda row: row[0]), dtype=np.float64).reshape(-1, 5)
    is_last = np.append(np.diff(table[:, 0]) > 0.0, True)[: len(table)]
    return PiecewiseCubic(starts_m=table[is_last, 0], coefficients=table[is_last, 1:])
