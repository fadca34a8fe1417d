"""Kinematics: poses, assembly branches, singular poses and workspace of a mechanism.

Entries are `solve_poses`, `assembly_branches`, `workspace` and `singular_poses`. `configurations` evaluates
many configurations in compiled code, and `continuation` moves them to goals.
"""
