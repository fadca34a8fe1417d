"""Modules that import a URDF file or a Pinocchio model as a scene; `urdf.reader` calls them in this order.

`source` and `vocabulary` check a file. `extensions` reads elements that tools add to URDF. `given` checks a
model in memory. `parser_messages` collects what Pinocchio's parser prints. `start` closes loops. `bodies`,
`loops`, `forces` and `visuals` convert elements of the file to elements of a scene.
"""
