"""Maps in ASAM OpenDRIVE 1.4 to 1.8."""

from .reader import read_opendrive

__all__ = ["read_opendrive"]
