"""Stress tests of the dynamics engines: long runs, stiff gains, extreme masses, singular poses and more.

The input is a string of topic letters, such as "ae". The output is a report, `stress.md` and `stress.json`,
with the number of cases that each engine passes. A `Case` (`cases.py`) measures one value of one engine at
one setting, and a `Bound` judges the value. Cases run in separate processes with a time limit. The other
modules generate the cases of one or several topics. Start reading at `topics.py`, which lists all topics.
"""
