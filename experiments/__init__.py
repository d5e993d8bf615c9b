"""The programs around the library.

Command line, the study's setting, figures, reports, benchmarks.

Nothing imports this package. ``cli`` parses and prints, ``jobs`` does what each command
asks.
"""
