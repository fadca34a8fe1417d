"""Command lines with hostile values in every argument and option, driven by the parsers themselves."""

from __future__ import annotations

from collections.abc import Iterator

import click

from crosscheck.cli.shared import cli
from crosscheck.library import SCENES
from crosscheck.library.options import options_of
from newton_euler.limits import LIMITS

NUMBERS = (
    "nan", "inf", "-inf", "-1", "0", "-0.0", "1e400", "1e308", "1e-320", "0x10", "1_0", "1,5", "\u0661",
    "9" * 4301, "1e3", "true", "", " ", "x", "--", "-", "1 2", "1e", "+1",
)  # fmt: skip

TEXTS = (
    "", " ", "x", "-", "=", ",", ":", ";", "a=", "=a", "a=b", "a=b=c", "a:b", "a,b", "(", ")", "a(", "a()",
    "a(1)", "a(b)", "normal(1,0.1)", "dumbbell.mass=normal(1,)", "crank.mass=normal(nan, 1)",
    "crank.mass=normal(1, -1)", "crank.mass=uniform(1, 0)", "crank.mass=values()",
    "crank.mass=grid(0, 1, 1e9)", "crank.mass=normal(1e308, 1e308)",
    "crank.mass=truncated_normal(1, 0, 1, 1)", "peak:", ":x", "peak:nothing", "peak:reaction_force[",
    "final:crank.", "final:1/0", "final:__import__('os')", "when:x>1", "peak:" + "(" * 300, "motor=0:1",
    "motor=1:0:3", "motor=nan:1", "motor=0:1:1e9", "motor=0:1:0", "crank=0,0,0", "crank=1,0",
    "crank=nan,0,0", "nothing=1,0,0", "../../../x", "x" * 5000, "\x1b[31m", "a\nb", "\u202e", "\udcff",
    "%s%n", "$(ls)", "*", "~", "2026-02-30", "0000-01-01", "9999-12-31", "2026-13-01", "Mars/Phobos",
    "../etc/passwd", "tcp://", "tcp://0.0.0.0:1", "random", "sobol", "newton_euler",
    "newton_euler,newton_euler", "newton_euler,x", "scene.json", "model.xml", "robot.urdf", "nothing.xml",
)  # fmt: skip

PATHS = (
    "", " ", ".", "..", "/", "/dev/null", "/dev/full", "/proc/self/mem", "/nonexistent/x", "scene.json",
    "scene.json/x", "model.xml", "x" * 300, "x/" * 2000, "a\nb", "\x1b[31m", "\udcff", "-", "*", "out.txt",
    "out.rrd", "out.xml", "out.urdf", "out.yaml", "out.csv",
)  # fmt: skip

KINDS: dict[type[click.ParamType], tuple[str, ...]] = {
    click.types.FloatParamType: NUMBERS,
    click.types.IntParamType: NUMBERS,
    click.IntRange: NUMBERS,
    click.Path: PATHS,
    click.types.StringParamType: TEXTS,
    click.Choice: TEXTS[:12],
}
"""Values by the type of a parameter; flags have none."""

REFUSED_LATER = ("--output", "model.xml/out")
"""Refused after everything else, so that no command that takes long begins."""

WHOLE: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "bench": (("scene.json",), REFUSED_LATER),
    "controllers": (("scene.json",), ("--engines", "newton_euler", "--output", "new")),
    "convert": (("scene.json", "out.yaml"), ()),
    "diff": (("model.xml", "model.xml"), REFUSED_LATER),
    "drives": (("scene.json",), ("--catalog", "catalog.csv", *REFUSED_LATER)),
    "engine-check": (("newton_euler",), ("--output", "new")),
    "explain": (("drift",), ()),
    "faults": (("scene.json",), REFUSED_LATER),
    "figures": ((), REFUSED_LATER),
    "identify": (("scene.json", "motion.csv"), ("--fit", "crank.mass", "--output", "new")),
    "importers": (("model.xml",), REFUSED_LATER),
    "list": (("scene.json",), ()),
    "loads": (("scene.json",), ("--output", "new")),
    "modes": (("scene.json",), ("--output", "new")),
    "regress": (("scene.json",), ("--output", "new")),
    "report": (("new",), ()),
    "run": (("scene.json",), ("--engines", "newton_euler", "--output", "new")),
    "stress": ((), REFUSED_LATER),
    "sun": (
        ("scene.json",),
        ("--axis", "crank=0,0,1", "--latitude", "11.5", "--date", "2026-03-21", *REFUSED_LATER),
    ),
    "sweep": (
        ("scene.json",),
        ("--vary", "crank.mass=normal(0.5, 0.01)", "--runs", "2", "--keep", "final:kinetic_energy",
         "--check", "0", "--rtol", "1e-6", "--output", "new"),
    ),
    "tune": (("model.xml",), REFUSED_LATER),
    "view": (("new.rrd",), ()),
    "workspace": (("scene.json",), ("--vary", "motor=-0.1:0.1:3", "--output", "new")),
    "year": (
        ("scene.json",),
        ("--axis", "crank=0,0,1", "--latitude", "11.5", "--year", "2026", *REFUSED_LATER),
    ),
}  # fmt: skip
"""Arguments and options of each command that are fine, and soon done or refused at the end."""


def replaced(options: tuple[str, ...], name: str, value: str) -> tuple[str, ...]:
    """Return options with another value of one, or with one more."""
    pairs = [(key, text) for key, text in zip(options[::2], options[1::2], strict=True) if key != name]
    return tuple(word for pair in [*pairs, (name, value)] for word in pair)


def command_lines() -> Iterator[tuple[str, ...]]:
    """Yield every command with every value in every argument and option of its parser."""
    for name, command in sorted(cli.commands.items()):
        arguments, options = WHOLE[name]
        yield (name, *arguments, *options)
        place = 0
        for parameter in command.params:
            values = KINDS.get(type(parameter.type), ())
            if isinstance(parameter, click.Argument):
                for value in values:
                    yield (name, *arguments[:place], value, *arguments[place + 1 :], *options)
                place += 1
            else:
                begins = options[-2:] == REFUSED_LATER and parameter.name == "output"
                for value in () if begins else values:
                    yield (name, *arguments, *replaced(options, parameter.opts[0], value))
                yield (name, *arguments, *options, parameter.opts[0])  # without a value, or a flag
    for scene, make in SCENES.items():
        for option in options_of(make):
            for value in (*NUMBERS, "x" * 5000, "\x1b[31m", "../x.csv"):
                yield ("list", scene, "--set", f"{option}={value}")
    for limit in LIMITS:
        for value in NUMBERS:
            yield ("list", "--set", f"{limit}={value}")
            yield (
                "run",
                "scene.json",
                "--engines",
                "newton_euler",
                "--output",
                "new",
                "--set",
                f"{limit}={value}",
            )
    for option in (
        "duration",
        "output_period",
        "redundancy_tolerance",
        "excitation",
        "key",
        "root",
        "loops",
        "base",
    ):
        for value in (*NUMBERS, *PATHS):
            yield ("convert", "model.xml", "out.yaml", "--set", f"{option}={value}")
            yield ("convert", "robot.urdf", "out.yaml", "--set", f"{option}={value}")
    for option in ("gravity", "ignore"):
        for value in (
            *NUMBERS,
            "0,0",
            "0,0,nan",
            "0,0,1e308",
            "0,0,0,0",
            "link",
            "robot",
            "x" * 5000,
            "joint,link,,",
        ):
            yield ("convert", "robot.urdf", "out.yaml", "--set", f"{option}={value}")
