"""What is driven, how much it counts, how it brakes: a user's words. Imports nothing heavy."""

from dataclasses import dataclass

DEFAULT_CASES = "study"


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """The options that say what a layout is placed for; texts as a user writes them.

    Attributes
    ----------
    scene : str
        Folder or .zip file of a scene; empty: the study's junction.
    cases, speeds : str
        See :func:`scenarios.selection.select_cases`; no speeds: those of the cases.
    approaches : str
        Arms with commas between; empty: all.
    weather : str
        Weathers with commas between.
    weights : str
        See :func:`scenarios.exposure.weigh`.
    phase : str
        See :func:`scenarios.runs.build_runs`.
    force : bool
        Drive speeds that the protocol does not.
    deceleration_mps2, build_up_s, latency_s, n_confirmations
        In place of the study's, see :class:`scenarios.aeb.AebRule`.
    detector : str
        See :func:`placement.detectors.load_detector`.
    vut_sensors : str
        Of the VUT itself, with commas between, see :class:`placement.setting.Setting`.
    packet_loss, vam_rate : float
        See :class:`placement.links.Links`.
    """

    scene: str = ""
    cases: str = DEFAULT_CASES
    speeds: str = ""
    approaches: str = ""
    weather: str = "day"
    weights: str = "run"
    phase: str = "aligned"
    force: bool = False
    deceleration_mps2: float | None = None
    build_up_s: float | None = None
    latency_s: float | None = None
    n_confirmations: int | None = None
    detector: str = "geometric"
    vut_sensors: str = "camera"
    packet_loss: float = 0.0
    vam_rate: float = 0.0
