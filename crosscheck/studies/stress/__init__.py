"""Every engine pushed until something breaks."""
