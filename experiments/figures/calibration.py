"""Figure of a fitted response table: its probabilities and what was found, recall by height."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..results.detectors import DetectorFitResult, RecallRecord
from .axes import BLUE, GREY, WIDTH_IN, finish_axes, new_figure


def plot_calibration(result: DetectorFitResult) -> Figure:
    """Share found against predicted probability, and by height in the image, with 95 % intervals.

    Parameters
    ----------
    result : DetectorFitResult
        What was fitted.

    Returns
    -------
    figure : Figure
        Two pairs of axes.
    """
    figure = new_figure(WIDTH_IN, 3.2)
    left, right = figure.subplots(1, 2)
    left.plot([0.0, 1.0], [0.0, 1.0], color=GREY, linestyle="--", linewidth=1.0)
    _draw(left, result.calibration, [group.expected for group in result.calibration])
    left.set_xlim(0.0, 1.0)
    finish_axes(left, x="probability of the table", y="share found", grid="both")
    heights = result.groups["height"]
    places = [float(number) for number in range(len(heights))]
    right.plot(places, [group.expected for group in heights], "s", mfc="none", mec="black", ms=6)
    _draw(right, heights, places)
    right.set_xticks(places, [group.name.removesuffix(" px") for group in heights], rotation=35)
    finish_axes(right, x="height in the image, px (squares: the table)", grid="y")
    for axes in (left, right):
        axes.set_ylim(0.0, 1.02)
    return figure


def _draw(axes: Axes, groups: tuple[RecallRecord, ...], places: list[float]) -> None:
    """Dots with bars from the lower to the upper end of their intervals."""
    value = [group.recall.value for group in groups]
    low = [max(0.0, group.recall.value - group.recall.low) for group in groups]
    high = [max(0.0, group.recall.high - group.recall.value) for group in groups]
    axes.errorbar(places, value, yerr=[low, high], fmt="o", color=BLUE, markersize=4, capsize=2)
