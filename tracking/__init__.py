"""Pixels and camera motion to object poses: the paper's Section III-A and Algorithm 1."""
