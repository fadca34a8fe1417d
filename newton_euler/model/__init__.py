"""Descriptions that all engines share: bodies, joints, couplings, forces, control laws, scenes, trajectories.

A `Scene` (module `scene`) describes one simulation: a `Mechanism` with forces, control laws, prescribed
motions and an initial state. An engine, such as newton_euler, turns a scene into a `Trajectory`.
Constructors check the values of elements. Elements declare the numbers that may vary from run to run (modules
`fields` and `variable`). This package imports no other subpackage of newton_euler. Start reading with the
modules `mechanism` and `forces`.
"""
