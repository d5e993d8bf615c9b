"""Private ground in view of cameras that are there: a warning above all numbers."""

from ..language import tr, trn
from ..results.numbers import first_of, percent
from .result import PlacementResult, Result

_MOST_TOLD = 4


def warnings(result: Result) -> list[str]:
    """What cameras see of private ground that the optimiser did not choose.

    Of a placement those that exist: it keeps them wherever they look. Of a layout that
    is evaluated or compared all of its own. Nothing where they see none, or no private
    ground was named.
    """
    if result.private_ground is None:
        return []
    units = result.private_ground.units
    is_chosen = isinstance(result, PlacementResult)
    found = [
        (share, unit, area)
        for unit, shares in units.items()
        for area, share in shares.items()
        if share > 0.0 and not (is_chosen and unit not in result.existing)
    ]
    if not found:
        return []
    # The most seen first, and no more than are read.
    found.sort(key=lambda view: -view[0])
    views = [
        tr("{unit} sees {share} of {area}", unit=unit, share=percent(share), area=area)
        for share, unit, area in found
    ]
    seen = first_of(views, _MOST_TOLD)
    if is_chosen:
        return [
            trn(
                "Warning: an existing camera has private ground in view: {views}.",
                "Warning: existing cameras have private ground in view: {views}.",
                len({unit for _, unit, _ in found}),
                views=seen,
            )
        ]
    return [tr("Warning: private ground is in view: {views}.", views=seen)]
