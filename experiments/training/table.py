"""A response table fitted to what a network finds in crops of junctions held out."""

from dataclasses import replace

import numpy as np

from geometry.weather import pick_weather
from placement.compute import Compute
from placement.detectors import ResponseDetector, load_planning_detector
from placement.detectors.evidence import Interval
from placement.detectors.fitting import fit_response
from placement.detectors.sightings import FalseAlarms, LabelledPicture, gather_sightings

from ..jobs.detector import table_text
from ..results.detectors import DetectorFitResult, build_alarms_record, build_fit_records
from ..results.drives import versions
from .card import MIN_CONFIDENCE
from .crops import WEATHERS, Crops
from .train import Found

_LEAST_PX = 8.0
_UNKNOWN = ("aspect", "frame_correlation")


def fit_table(crops: Crops, found: Found, *, source: str, command: str, compute: Compute) -> str:
    """The table as TOML, for ``--detector FILE``.

    Parameters
    ----------
    crops : Crops
        With labels; each is a track of its own.
    found : list
        Boxes and confidence of each crop, by class.
    source, command : str
        What the crops are of, and how this was called.
    compute : Compute
        Seed of the intervals.
    """
    pictures = [_picture(crops, row, by_class) for row, by_class in enumerate(found)]
    sightings, _ = gather_sightings(pictures, n_confirmations=3)
    fit = fit_response(sightings, name="vru.toml", seed=compute.seed)
    builtin = load_planning_detector("response")
    assert isinstance(builtin, ResponseDetector)
    detector = replace(
        fit.detector,
        cyclist_end_on=builtin.cyclist_end_on,
        frame_correlation=builtin.frame_correlation,
    )
    kept = {key: getattr(builtin, key) for key in ("cyclist_end_on", "frame_correlation")}
    intervals = {key: Interval(value, value, value) for key, value in kept.items()}
    fit = replace(fit, detector=detector, intervals={**fit.intervals, **intervals})
    table, groups, calibration = build_fit_records(fit)
    nothing = FalseAlarms(pictures=1, alarms=0, chances=0, confirmed=0)
    result = DetectorFitResult(
        name=fit.detector.name,
        source=source,
        frames=fit.frames,
        found=fit.found,
        tracks=fit.tracks,
        unknown=_UNKNOWN,
        table=table,
        groups=groups,
        calibration=calibration,
        false_alarms=build_alarms_record(nothing, 10.0),
        command=command,
        seconds={},
        versions=versions(),
    )
    return table_text(fit, result)


def _picture(
    crops: Crops, row: int, by_class: list[tuple[np.ndarray, np.ndarray]]
) -> LabelledPicture:
    """A crop, its label if it is large enough, and the boxes that count for it."""
    kind, box = int(crops.vru_class[row]), crops.box_px[row]
    n_labels = int(kind >= 0 and box[3] - box[1] >= _LEAST_PX)
    sure = [boxes[confidence >= MIN_CONFIDENCE] for boxes, confidence in by_class]
    # A cyclist may be found as a person, as in an evaluation.
    own = np.concatenate(sure) if kind == 2 else sure[0]
    weather = pick_weather(WEATHERS[int(crops.weather[row])], "weather")
    return LabelledPicture(
        track=row,
        frame=0,
        label_px=box[None][:n_labels],
        label_class=np.full(n_labels, kind),
        seen_share=np.full(n_labels, min(crops.visible_share[row], 1.0)),
        contrast=np.full(n_labels, weather.contrast),
        aspect_deg=np.full(n_labels, 90.0),
        found_px=own,
        is_whole=False,
    )
