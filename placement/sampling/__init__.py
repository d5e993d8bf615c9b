"""Uncertainty -> sampled worlds -> detection tables of many worlds -> layouts in other worlds."""
