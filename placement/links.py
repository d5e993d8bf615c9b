"""How detections reach the VUT: messages get lost, and some VRUs announce themselves."""

from dataclasses import dataclass

from geometry.errors import InputError


@dataclass(frozen=True, slots=True, kw_only=True)
class Links:
    """Radio between RSUs, VRUs and the VUT.

    Attributes
    ----------
    packet_loss : float
        Probability that a message - an RSU's collective perception message (CPM) of one frame, or
        a VRU's awareness message (VAM) - is lost. 0 .. 1
    vam_rate : float
        Share of the runs whose VRU carries a device that sends VAMs. 0 .. 1
    """

    packet_loss: float = 0.0
    vam_rate: float = 0.0

    def __post_init__(self) -> None:
        for field in ("packet_loss", "vam_rate"):
            if not 0.0 <= getattr(self, field) <= 1.0:
                raise InputError(f"links.{field}", getattr(self, field), "0 .. 1")
