"""The report: a file for each section with its sentences, table and figure; one page out of all."""
