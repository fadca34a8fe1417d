"""What measures the project itself; nothing else imports it."""
