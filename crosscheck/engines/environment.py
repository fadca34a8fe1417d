"""Environment of the command line's process, for engines that read it when they are imported."""

ENVIRONMENT = {
    # MuJoCo draws nothing here; it would load GLFW, whose process prints a message if interrupted
    "MUJOCO_GL": "disable",
}
"""Environment variables by name."""
