"""Sources of the messages, and the script that compiles them."""
