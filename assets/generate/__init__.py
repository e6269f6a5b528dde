"""Makes the meshes and descriptions in `assets`; same code, same bytes."""
