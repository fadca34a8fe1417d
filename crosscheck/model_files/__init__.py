"""Models of other tools read, and scenes written as such."""
