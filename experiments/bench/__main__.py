"""``python -m experiments.bench``."""

from .main import main

main()
