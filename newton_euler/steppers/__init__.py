"""Integrators that run in native code, written once for all scenes."""
