"""Analyses of a mechanism: kinematics, linear models, loads, identification and sensitivities.

Input is a scene, often with states or a trajectory; output is a frozen record of arrays. Each folder has one
subject and one or two public functions, named in its first docstring. Start with
`kinematics/poses.py`, which solves closed poses, or `linear/linearization.py`.
"""
