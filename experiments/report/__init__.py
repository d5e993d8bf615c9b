"""The report: one page out of all parts of an answer."""
