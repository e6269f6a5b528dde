"""Commands between operator and robot: what the robot side accepts, and when it holds."""
