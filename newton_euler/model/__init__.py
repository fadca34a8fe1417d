"""Descriptions that all engines share: bodies, joints, couplings, forces, control laws, scenes, trajectories.

A `Scene` (`scene`) describes one simulation: a `Mechanism` with forces, control laws, prescribed motions
and an initial state. An engine turns a scene into a `Trajectory`. Constructors check the values of
elements. Elements declare the numbers that may vary from run to run (`fields`, `variable`). This room
imports no other room. Start reading with `mechanism` and `forces`.
"""
