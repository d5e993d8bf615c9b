"""What is known of a layout that was chosen because it locates road users."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class LocatedChoice:
    """The layout of the highest located APR of a pool.

    Attributes
    ----------
    pose_index : tuple of int
        Rows of the table.
    limit_m : float
        A run is located if its place is known so well, see
        :func:`scenarios.decision.located_sd_m`. [m]
    share : float
        Located APR of the choice, units aimed by eye. 0 .. 1
    share_before : float
        The same of the layout that would be chosen otherwise.
    least_apr : float
        What every layout of the pool reaches at least. 0 .. 1
    n_judged : int
        Layouts of the pool that the filter judged.
    """

    pose_index: tuple[int, ...]
    limit_m: float
    share: float
    share_before: float
    least_apr: float
    n_judged: int
