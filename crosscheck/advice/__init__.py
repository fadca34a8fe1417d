"""Advice on what a crosscheck has measured, in words and with the numbers of that run."""

from crosscheck.advice.advise import advise
from crosscheck.advice.measured import WANTED, Advice, Found

__all__ = ["WANTED", "Advice", "Found", "advise"]
