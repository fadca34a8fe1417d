"""What every engine shares: bodies, joints, couplings, forces, the scene, its states and trajectories."""
