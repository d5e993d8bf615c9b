"""Words that a refusal has among others, and all of its words."""

from contextlib import contextmanager

import pytest

from geometry.errors import InputError


@contextmanager
def refused_saying(words, kind=InputError):
    """Within it, something is refused, and the message has these words."""
    with pytest.raises(kind) as caught:
        yield
    assert words in str(caught.value)


def refusal_of(function, *arguments, kind=InputError, **options):
    """Words in which a call is refused."""
    with pytest.raises(kind) as caught:
        function(*arguments, **options)
    return str(caught.value)
