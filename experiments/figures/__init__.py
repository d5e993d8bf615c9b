"""Figures: each is drawn into matplotlib axes, and returns them."""
