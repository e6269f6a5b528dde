"""Composition root: command line, processes, viewer."""
