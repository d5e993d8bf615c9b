"""The command line: one file for each command, which reads its options, runs the job and prints."""
