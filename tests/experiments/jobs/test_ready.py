"""What the second process loads and calls while it waits: a name that is gone ends it
unseen.
"""

from importlib import import_module
from importlib.util import find_spec

from experiments.jobs import READY


def test_all_that_the_second_process_gets_ready_with_is_there():
    missing = [name for name in READY["modules"] if find_spec(name) is None]
    assert not missing
    module, _, function = READY["prepare"].partition(":")
    assert callable(getattr(import_module(module), function))
