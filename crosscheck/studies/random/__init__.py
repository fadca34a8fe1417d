"""Random mechanisms with random loops, joints and inertias."""
