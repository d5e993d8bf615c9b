"""Certificates, and their check without the optimiser's code."""
