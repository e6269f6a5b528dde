"""Messages, keys, bus, clock and recordings: everything that leaves a process."""
