"""Measurements of the project itself; nothing else imports them."""
