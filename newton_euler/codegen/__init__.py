"""Native code from traced scalars and from a subset of Python, and its cache."""
