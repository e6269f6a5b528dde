"""Poses, stamps, cameras and fixture solids: plain data every other package builds on."""
