"""Results of jobs as frozen values, written to folders and read back."""
