"""The sun over a place, set-points that face it, and a tracker's day: motion, error and energy."""
