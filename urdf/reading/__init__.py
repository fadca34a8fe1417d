"""URDF and loop file -> scene: what `urdf.read` is made of. Needs Pinocchio, which parses the URDF."""
