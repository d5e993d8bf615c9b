"""Without torch, examples in modules that need it are not looked for."""

from importlib.util import find_spec

collect_ignore = (
    [] if find_spec("torch") else ["__main__.py", "card.py", "network.py", "table.py", "train.py"]
)
