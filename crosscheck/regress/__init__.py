"""Guards figures of scenes and models against change: measured, and compared with a stored baseline."""
