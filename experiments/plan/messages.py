"""What browsers ask for: changes of the plan, and requests beside them."""

import msgspec
from msgspec import Struct

from geometry.errors import InputError, Unquoted

from .session import Change, Redo, Undo


class Ask(Struct, tag_field="do", tag="ask", forbid_unknown_fields=True):
    """Ask the optimiser: "next", "complete" to `units`, "re-aim", "cheapest", "why-not" `site`."""

    request: str
    units: int = 0
    site: str = ""


class Revert(Struct, tag_field="do", tag="revert", forbid_unknown_fields=True):
    """Take a gesture back that is given up, as if it had not been begun."""

    gesture: str


class Cancel(Struct, tag_field="do", tag="cancel", forbid_unknown_fields=True):
    """Let the optimiser stop."""


class TakeProposal(Struct, tag_field="do", tag="take", forbid_unknown_fields=True):
    """Take a proposal over, in place of what is worked on or as a further variant."""

    number: int
    as_variant: bool = False


class DropProposal(Struct, tag_field="do", tag="drop", forbid_unknown_fields=True):
    """Drop a proposal."""

    number: int


class ShowCoverage(Struct, tag_field="do", tag="coverage", forbid_unknown_fields=True):
    """Whether pixel density and blind spots on the road are wanted."""

    is_shown: bool


class ChooseSensors(Struct, tag_field="do", tag="sensors", forbid_unknown_fields=True):
    """Models that the optimiser may mount; none: the default grid's."""

    names: list[str]


Message = (
    Change
    | Undo
    | Redo
    | Revert
    | Ask
    | Cancel
    | TakeProposal
    | DropProposal
    | ShowCoverage
    | ChooseSensors
)
_DECODER = msgspec.json.Decoder(Message)


def read_message(text: bytes) -> Message:
    """What a browser asks for. Raises InputError if it is none of these."""
    try:
        message: Message = _DECODER.decode(text)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError("message", Unquoted(error), "one that the page sends") from None
    return message
