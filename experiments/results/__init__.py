"""Results of jobs as frozen values, and how they are written to a folder and read back."""
