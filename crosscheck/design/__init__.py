"""Numbers for designers: loads, workspace, controllers, identified parameters."""
