"""What is refused, by some of its words; `refusals` asks for all of them."""

from contextlib import contextmanager

import pytest

from geometry.errors import InputError


@contextmanager
def refused_about(pattern):
    """Within it, something is refused in words that a regular expression finds."""
    with pytest.raises(InputError, match=pattern) as caught:
        yield caught
