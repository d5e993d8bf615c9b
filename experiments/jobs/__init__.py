"""The work behind each command, from its options to its result."""
