"""The detector that is shipped: crops drawn at many junctions, training, and its metrics."""
