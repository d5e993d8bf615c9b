"""What we show: the command line, the study's setting, comparisons, figures, reports, benchmarks.

Nothing imports this package. ``cli`` parses and prints, ``jobs`` does what each command asks.
"""
