"""What is refused, and in which words."""

from contextlib import contextmanager

import pytest

from geometry.errors import InputError


@contextmanager
def refused_with(message, kind=InputError):
    """Within it, something is refused with exactly these words."""
    with pytest.raises(kind) as caught:
        yield
    assert str(caught.value) == message
