"""Without torch, examples in modules that need it are not looked for."""

from importlib.util import find_spec

_WITH_TORCH = ["__main__.py", "card.py", "network.py"]
collect_ignore = [] if find_spec("torch") else _WITH_TORCH
