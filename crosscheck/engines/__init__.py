"""The engines that are compared, their settings, and their runs."""
