"""Stress tests: cases at the limits of every engine, and how many of them each engine passes.

In: letters of topics. Out: a report, `stress.md` and `stress.json`. A `Case` (`cases.py`) measures one value
of one engine at one setting and judges it by a `Bound`; cases run in separate processes with a time limit.
The other modules yield the cases of a topic. Start reading at `topics.py`, whose table `TOPICS` names them.
"""
