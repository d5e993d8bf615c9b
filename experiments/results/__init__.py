"""What a job returns, and how it is written to a folder and read back."""
