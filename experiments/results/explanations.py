"""Parts of a result that explain it: contributions, runs not avoided, sensitivity, private ground."""

from typing import Annotated, Literal

from .record import LayoutValueRecord, Record, RunId, Share, StageName, says


class RescueRecord(Record, frozen=True, kw_only=True):
    """A candidate that would save a run as a further unit."""

    unit: Annotated[str, says("Name of the candidate pose.")]
    site: Annotated[str, says("Its site.")]
    distance_m: Annotated[
        float, says("From the nearest unit, in metres; 0: at the same mount.", ge=0)
    ]
    margin_s: Annotated[float, says("Time to spare that it leaves, in seconds.")]


class MissedReasonRecord(Record, frozen=True, kw_only=True):
    """Why that unit does not detect the road user."""

    cause: Annotated[
        Literal["hidden", "out of view", "cut off", "too dark", "too far", "otherwise"],
        says("What is in the way, or missing."),
    ]
    thing: Annotated[str, says("What hides the road user; empty for other causes.")]
    frames: Annotated[int, says("In how many frames.", ge=1)]


class MissedRunRecord(Record, frozen=True, kw_only=True):
    """A run with weight that is not avoided in the world as planned, on the detection table."""

    run: Annotated[RunId, says("Which run.")]
    outcome: Annotated[
        Literal["hopeless", "never seen", "never confirmed", "too late"],
        says("hopeless: no frame comes early enough, whoever looks; else what the units achieve."),
    ]
    late_s: Annotated[
        float | None, says("By how much braking sets in too late, in seconds; null: never.")
    ]
    frames_in_time: Annotated[int, says("Frames from which braking in time could follow.", ge=0)]
    frames_seen: Annotated[
        int, says("Of these, those in which a unit detects the road user.", ge=0)
    ]
    unit: Annotated[
        str,
        says("Id of the unit that is told of: the nearest that looks there; empty if hopeless."),
    ]
    reasons: Annotated[tuple[MissedReasonRecord, ...], says("The most frequent one first.")]
    rescue: Annotated[
        RescueRecord | None,
        says(
            "Nearest candidate that would save the run as a further unit; null: none, or nobody looked, as where worlds are sampled."
        ),
    ]


class ContributionRecord(Record, frozen=True, kw_only=True):
    """What a unit adds to the others, on the detection table."""

    unit: Annotated[str, says("Id in the layout.")]
    only_runs: Annotated[
        tuple[RunId, ...],
        says(
            "Runs with weight that are avoided with it and not without it; where worlds are sampled with # and the number of the world behind the name."
        ),
    ]
    marginal_apr: Annotated[Share, says("APR of all less that of the others.")]
    first_share: Annotated[Share, says("Its part in the first confirmations, by weight.")]
    mean_delay_s: Annotated[
        float,
        says(
            "By how much later what the others avoid, too, is confirmed without it: mean by weight, in seconds."
        ),
    ]
    max_delay_s: Annotated[float, says("The most of it in any run, in seconds.")]
    without: Annotated[LayoutValueRecord, says("What the others are worth.")]


class PooledLayoutRecord(Record, frozen=True, kw_only=True):
    """A layout of candidates."""

    units: Annotated[tuple[str, ...], says("Names of the candidate poses.")]
    objective: Annotated[
        float, says("Value in the first stage, in the unit that its name ends in.")
    ]
    apr: Annotated[Share, says("APR on the detection table.")]
    apr_one_failed: Annotated[Share, says("APR if the unit that is needed most fails.")]
    smallest_margin_s: Annotated[
        float,
        says("Smallest time to spare of the avoided runs, in seconds; 0 where there is none."),
    ]
    mean_margin_s: Annotated[
        float,
        says(
            "Mean time to spare of the avoided runs by weight, in seconds; 0 where there is none."
        ),
    ]
    cost_eur: Annotated[float, says("Units, and sites once, in EUR.")]


class SiteShareRecord(Record, frozen=True, kw_only=True):
    """How often a site carries a unit."""

    site: Annotated[str, says("Name of the site.")]
    share: Annotated[Share, says("Of the layouts found.")]


class PoseShareRecord(Record, frozen=True, kw_only=True):
    """How often a pose is chosen."""

    unit: Annotated[str, says("Name of the candidate pose.")]
    share: Annotated[Share, says("Of the layouts found.")]


class PoolRecord(Record, frozen=True, kw_only=True):
    """Layouts that are as good in the first stage, or nearly."""

    stage: Annotated[StageName, says("The first stage.")]
    tolerance: Annotated[
        float,
        says("How much worse they may be: in shares of the runs, or of units or costs.", ge=0),
    ]
    is_complete: Annotated[
        bool,
        says("Whether all choices were gone through; else one unit was exchanged for another."),
    ]
    within: Annotated[int, says("How many were found.", ge=1)]
    sets: Annotated[tuple[PooledLayoutRecord, ...], says("The best ones, the best first.")]
    sites: Annotated[tuple[SiteShareRecord, ...], says("Sites, the most frequent first.")]
    poses: Annotated[tuple[PoseShareRecord, ...], says("Candidate poses, the most frequent first.")]


class ExplainedRecord(Record, frozen=True, kw_only=True):
    """Why these units, what they miss, what else would do; on the detection table. Runs of weight 0
    are in no list.
    """

    contributions: Annotated[tuple[ContributionRecord, ...], says("One for each unit.")]
    not_avoided: Annotated[
        tuple[MissedRunRecord, ...], says("Runs that are not avoided, in the order of the runs.")
    ]
    runs_without_weight: Annotated[
        int, says("How many runs have weight 0, and are left out.", ge=0)
    ]
    pool: Annotated[PoolRecord | None, says("Layouts as good; null unless asked for with --pool.")]


class PlannedOutcomeRecord(Record, frozen=True, kw_only=True):
    """As planned."""

    apr: Annotated[Share | None, says("APR by the evaluator's rule.")]
    apr_one_failed: Annotated[Share | None, says("APR if the unit that is needed most fails.")]
    smallest_margin_s: Annotated[
        float | None,
        says("Smallest time to spare, in seconds; null: nothing is avoided, or chance decides."),
    ]


class VariedAssumptionRecord(Record, frozen=True, kw_only=True):
    """A value that it may have instead."""

    value: Annotated[float, says("In the unit of the assumption's name.")]
    apr: Annotated[Share | None, says("APR by the evaluator's rule.")]
    apr_one_failed: Annotated[Share | None, says("APR if the unit that is needed most fails.")]
    smallest_margin_s: Annotated[
        float | None,
        says("Smallest time to spare, in seconds; null: nothing is avoided, or chance decides."),
    ]
    lost_runs: Annotated[
        tuple[RunId, ...], says("Runs that are avoided as planned, and then no longer.")
    ]
    unmoved: Annotated[
        tuple[str, ...],
        says("Ids of units that stayed where they are: there they would be inside something."),
    ]


class AssumptionRecord(Record, frozen=True, kw_only=True):
    """Something that the plan takes for granted."""

    name: Annotated[str, says("Which; its ending tells the unit.")]
    planned_value: Annotated[
        float | None,
        says(
            "What the plan assumes, in the unit of the name; null where the question does not arise."
        ),
    ]
    reason: Annotated[str, says("Why it is varied so far.")]
    is_ours: Annotated[bool, says("Whether that is an assumption of this project, not a source.")]
    left_out: Annotated[str, says("Why it was not varied; empty if it was.")]
    varied: Annotated[tuple[VariedAssumptionRecord, ...], says("By ascending value.")]


class SensitivityRecord(Record, frozen=True, kw_only=True):
    """What becomes of the layout if an assumption is wrong: one at a time."""

    planned: Annotated[PlannedOutcomeRecord, says("As planned.")]
    assumptions: Annotated[tuple[AssumptionRecord, ...], says("One for each assumption.")]


class PrivateAreaRecord(Record, frozen=True, kw_only=True):
    """An area."""

    name: Annotated[str, says("Name in the file.")]
    area_m2: Annotated[float, says("Size, in square metres.", ge=0)]


class PrivateGroundRecord(Record, frozen=True, kw_only=True):
    """What cameras see of areas that they must not look into."""

    eur_per_m2: Annotated[
        float, says("Price of a square metre in a picture, in EUR; 0: none.", ge=0)
    ]
    price_eur: Annotated[float, says("That is in the cost, in EUR, though nobody pays it.", ge=0)]
    areas: Annotated[tuple[PrivateAreaRecord, ...], says("The areas.")]
    units: Annotated[dict[str, dict[str, Share]], says("Of each unit, by its id.")]
