"""Recordings of real road users against what this project predicts of them."""
