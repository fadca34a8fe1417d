"""Kinematics: poses, assembly branches, singular poses and workspace of a mechanism.

The public functions are `solve_poses`, `assembly_branches`, `workspace` and `singular_poses`. The module
`configurations` evaluates many configurations in compiled code, and `continuation` moves them to goals.
"""
