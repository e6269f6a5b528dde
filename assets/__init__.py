"""Robots and objects that come with the program, and the scripts that make them."""
