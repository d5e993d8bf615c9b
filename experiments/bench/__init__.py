"""Speed as ratios to named references: ``python -m experiments.bench``."""
