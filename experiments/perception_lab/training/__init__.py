"""The detector that is shipped.

Crops drawn at many junctions, training, and its metrics.
"""
