"""Requests of browsers: one small value for each, read from JSON."""

import msgspec
from msgspec import UNSET, Struct, UnsetType

from geometry.errors import InputError, Unquoted
from geometry.text_formats import parse_json

from ..language import mark


class _Request(Struct, tag_field="do", forbid_unknown_fields=True):
    """A JSON object whose field "do" says which request it is."""


class AddUnit(_Request, tag="add"):
    """Mount a sensor at a site; by default it looks at the middle of the junction.

    A height that the site does not have is brought into its range: what is pasted may
    be from another site. Its first steps are of the gesture that drags it from there.
    """

    site: str
    sensor: str
    yaw_deg: float | None = None
    pitch_deg: float | None = None
    height_m: float | None = None
    fov_deg: float | None = None
    gesture: str = ""


class ChangeUnit(_Request, tag="change"):
    """Turn, tilt, raise, zoom, move or exchange a unit; steps of one gesture are undone at once."""

    unit: str
    yaw_deg: float | UnsetType = UNSET
    pitch_deg: float | UnsetType = UNSET
    height_m: float | UnsetType = UNSET
    fov_deg: float | UnsetType = UNSET
    site: str | UnsetType = UNSET
    sensor: str | UnsetType = UNSET
    gesture: str = ""


class RemoveUnit(_Request, tag="remove"):
    """Take a unit down."""

    unit: str


class AddVariant(_Request, tag="add-variant"):
    """Copy the variant that is worked on, and go on with the copy."""

    name: str = ""


class SelectVariant(_Request, tag="select-variant"):
    """Go on with another variant."""

    index: int


class RenameVariant(_Request, tag="rename-variant"):
    """Name the variant that is worked on."""

    name: str


class RemoveVariant(_Request, tag="remove-variant"):
    """Drop the variant that is worked on."""


class Undo(_Request, tag="undo"):
    """Take the last change back."""


class Redo(_Request, tag="redo"):
    """Make the change again that was taken back."""


class PutPole(_Request, tag="pole"):
    """Put a pole of one's own somewhere, or the one that is named, with all that hangs on it."""

    east_m: float
    north_m: float
    site: str = ""


class RemovePole(_Request, tag="remove-pole"):
    """Take a pole of one's own away that carries nothing."""

    site: str


Change = (
    AddUnit
    | ChangeUnit
    | RemoveUnit
    | PutPole
    | RemovePole
    | AddVariant
    | SelectVariant
    | RenameVariant
    | RemoveVariant
)
"""Requests that :func:`.changes.change_state` carries out."""


class Ask(_Request, tag="ask"):
    """Ask the optimiser: "next", "complete" to `units`, "re-aim", "cheapest", "why-not" `site`."""

    request: str
    units: int = 0
    site: str = ""


class Revert(_Request, tag="revert"):
    """Take a gesture back that is given up, as if it had not been begun."""

    gesture: str


class Cancel(_Request, tag="cancel"):
    """Let the optimiser stop."""


class CancelOpening(_Request, tag="cancel-opening"):
    """Let no other scene be opened that is being read or made."""


class TakeProposal(_Request, tag="take"):
    """Take a proposal over, in place of what is worked on or as a further variant."""

    number: int
    as_variant: bool = False


class DropProposal(_Request, tag="drop"):
    """Drop a proposal."""

    number: int


class ShowCoverage(_Request, tag="coverage"):
    """Show or hide pixel density and blind spots on the road."""

    is_shown: bool


class ShowErrors(_Request, tag="errors"):
    """Show or hide errors of positions on the road."""

    is_shown: bool


class ChooseSensors(_Request, tag="sensors"):
    """Models that the optimiser may mount; none: the default grid's."""

    names: list[str]


class ChangeQuestion(_Request, tag="question"):
    """Drive other cases, or see and judge them otherwise; what is not given stays as it is."""

    cases: str | UnsetType = UNSET
    weather: str | UnsetType = UNSET
    detector: str | UnsetType = UNSET
    weights: str | UnsetType = UNSET
    cars: str | UnsetType = UNSET
    vam_rate: float | UnsetType = UNSET


Message = (
    Change
    | Undo
    | Redo
    | Revert
    | ChangeQuestion
    | Ask
    | Cancel
    | CancelOpening
    | TakeProposal
    | DropProposal
    | ShowCoverage
    | ShowErrors
    | ChooseSensors
)
"""All that a browser can ask for."""


def read_message(text: bytes) -> Message:
    """A request from its JSON. Raises InputError if it is none of these."""
    expected = mark("one that the page sends")
    try:
        document = parse_json(text, "message", expected)
        message: Message = msgspec.convert(document, Message)
    except InputError as error:
        raise InputError(mark("message"), error.got, expected) from None
    except msgspec.ValidationError as error:
        raise InputError(mark("message"), Unquoted(error), expected) from None
    return message
