"""Files that nobody here made, for tests of what is read of maps."""

from pathlib import Path

import pytest

_FOLDER = Path(__file__).parents[4] / "shared" / "inputs"


@pytest.fixture(scope="session")
def real_input():
    """Path of a file that nobody here made; the test is skipped where these are not at
    hand.
    """

    def find(name):
        path = _FOLDER / name
        if not path.exists():
            pytest.skip(
                f"{name} is not at hand: ../shared/inputs is not part of the project"
            )
        return path

    return find
