"""One module per process; each reads its configuration from standard input."""
