"""MJCF -> scene: what `mjcf.read` is made of. Needs MuJoCo, which compiles the file."""
