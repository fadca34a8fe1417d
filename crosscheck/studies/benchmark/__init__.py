"""Run time measured against error, for every engine and setting."""
