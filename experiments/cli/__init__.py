"""The command line, a file for each command.

It reads the options, runs the job and prints.
"""
