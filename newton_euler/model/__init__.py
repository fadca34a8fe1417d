"""Description that all engines share: bodies, joints, couplings, forces, scene, states, trajectories."""
