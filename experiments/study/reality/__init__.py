"""Recordings of road users against what this project predicts."""
