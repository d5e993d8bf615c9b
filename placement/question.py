"""The question: what a user asks, in the words of the command line. Imports nothing heavy."""

from dataclasses import dataclass

DEFAULT_CASES = "study"
BASELINE_NAME = "carlancap-12"
"""What a user calls the study's own layout."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """What is asked: what is driven and how it brakes, what may be mounted, how hard to look.

    Attributes
    ----------
    scene : str
        Folder or .zip file of a scene; empty: the study's junction.
    cases, speeds : str
        See :func:`scenarios.cases.select_cases`; no speeds: those of the cases.
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
        See :class:`placement.setting.Links`.
    budget : int, optional
        Units.
    budget_cost : float, optional
        Money. [EUR]
    target : str
        A share, or "max"; empty: none.
    least : str
        "units" or "cost": what a target is reached with the least of.
    min_case_apr, survive, site_capacity, site_cost_eur, separation_m
        See :class:`placement.wishes.Wishes`.
    keep, within : str
        Layouts by name or file; empty: none.
    force_site, forbid_site : str
        Sites with commas between.
    stage_weights : str
        Such as "apr=1,mean_margin_s=0.1"; empty: the stages in order.
    fusion : str
        See :class:`placement.optimiser.PlacementProblem`.
    sensors : str
        Models with commas between; empty: the default grid's.
    no_look : str
        File of areas that cameras must not look into; empty: none.
    no_look_share : float, optional
        Share of an area that a camera may have in its picture; by default none, or any where it
        has a price.
    no_look_price : float
        Of a square metre of such an area in a camera's picture. [EUR]
    study_poses : bool
        Whether the study's 12 poses are candidates.
    solver, time_limit_s, gap, milp_solver
        See :class:`placement.optimiser.Effort`.
    refine : bool
        Whether to look between the poses of the grid.
    samples : int
        Sampled worlds to choose in; 0: the nominal one.
    uncertainty : str
        See :func:`placement.sampling.load_uncertainty`.
    pool : int
        Layouts as good to list beside the one chosen.
    pool_tolerance : float
        See :func:`placement.explain.find_pool`.
    risk : str
        "mean", "worst", or the share of the worst worlds whose mean counts.
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
    budget: int | None = None
    budget_cost: float | None = None
    target: str = ""
    least: str = "units"
    min_case_apr: float = 0.0
    survive: int = 0
    site_capacity: int | None = None
    site_cost_eur: float | None = None
    separation_m: float = 0.0
    keep: str = ""
    within: str = ""
    force_site: str = ""
    forbid_site: str = ""
    stage_weights: str = ""
    fusion: str = "any"
    sensors: str = ""
    no_look: str = ""
    no_look_share: float | None = None
    no_look_price: float = 0.0
    study_poses: bool = True
    solver: str = "auto"
    time_limit_s: float = 20.0
    gap: float = 0.0
    milp_solver: str = "HIGHS"
    refine: bool = False
    samples: int = 0
    uncertainty: str = "default"
    risk: str = "mean"
    pool: int = 0
    pool_tolerance: float = 0.0
