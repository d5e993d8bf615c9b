"""Jobs: everything a command needs to be done, from its question to its result."""
