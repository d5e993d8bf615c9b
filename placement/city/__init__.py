"""Many junctions under one budget: a front of each, and one point of each front."""
