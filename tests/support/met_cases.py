"""Cases with a car and a motorcyclist, laid as crossings: what tests of bodies need."""

from pathlib import Path

MET_CASES = Path(__file__).with_suffix(".toml")
