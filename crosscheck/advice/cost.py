"""The engine that reaches an error at the least cost, as far as one run knows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from crosscheck.advice.measured import WANTED, Advice, Found


def cost_advice(found: Found) -> Iterator[Advice]:
    """From wall times and how far each run is off; nothing for models that differ or a single engine."""
    errors = found.errors
    if not errors or not found.models_agree:
        return
    by_time = sorted(errors, key=found.wall_time)
    able = [name for name in by_time if errors[name] <= WANTED]
    costs = ", ".join(f"{name} {found.wall_time(name):.2g} s ({errors[name]:.1e} off)" for name in by_time)
    costs += "".join(_setup(name, found.runs[name].settings) for name in by_time)
    if able:
        run = found.runs[able[0]]
        step = run.settings.get("timestep")
        how = f"timestep {step:.4g} s" if step else f"rtol {run.settings['rtol']:g}"
        text = (
            f"{able[0]} ({run.settings['integrator']}, {how}) is the cheapest of these runs with an error of "
            f"at most {WANTED:g} (m, rad)"
        )
    else:
        text = f"none of these runs has an error of at most {WANTED:g} (m, rad)"
    bench = f"`crosscheck bench {found.source}` measures what each needs for it"
    yield Advice("cost", f"{text}: {costs}; {bench}")


def _setup(name: str, settings: Mapping[str, Any]) -> str:
    """Return the s that an engine compiles before its first run, where it says so."""
    if "compile_time" not in settings:
        return ""
    traced, compiled = settings["trace_time"], settings["compile_time"]
    return f"; before, not counted, {name} traced in {traced:.2g} s and compiled in {compiled:.2g} s"
