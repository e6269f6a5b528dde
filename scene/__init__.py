"""Object database, robot model, scene graph and routes (Eq. 1, Eq. 4)."""
