"""Stress tests of an engine: the settings with which each topic runs it, and what its runs cost."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

Options = dict[str, Any]
"""Options of the engine's simulation function by name, such as the integrator and its step."""

Topic = Literal["long tops", "starts", "singular", "stiff gains", "masses", "numbers", "fixed steps", "noise"]
"""Topic whose cases run an engine with settings of its own; see `crosscheck.studies.stress.topics`."""

LongRuns = Mapping[str, Mapping[float, tuple[Options, ...]]]
"""Settings of long runs by library scene and duration, s: as long as the engine can run within minutes."""


class StressSettings(NamedTuple):
    """Settings of an engine for `crosscheck stress`.

    Attributes:
        typical: the usual setting, or one for each formulation; used where a case need not try all settings.
        topics: settings by topic; `typical` is used for topics that are missing.
        long_runs: settings of long runs.
        stepped: settings without a step, whose largest usable step is searched.
        adaptive: settings without a tolerance, whose loosest usable one, `rtol` and `atol`, is searched.
        step_option: name of the option that is the step, s.
        at_step: returns the usual setting at a step, s; None if its steps follow from tolerances.
        position_error: m, error that runs may have on a machine of some decimeters.
        is_slow: True if runs of many thousand steps take minutes, since Python evaluates the equations.
        integrates_work: False if the work of controllers would cost a call of Python at each step.
    """

    typical: tuple[Options, ...] = ({},)
    topics: Mapping[Topic, tuple[Options, ...]] = MappingProxyType({})
    long_runs: LongRuns = MappingProxyType({})
    stepped: tuple[Options, ...] = ()
    adaptive: tuple[Options, ...] = ()
    step_option: str = "step"
    at_step: Callable[[float], Options] | None = None
    position_error: float = 1e-8
    is_slow: bool = False
    integrates_work: bool = True
