"""Command lines that are refused: options that are empty, impossible or too much, or overwrite a source."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from hostile_files import TEXTS
from hostile_results import Refused, nothing, written

SWEEP_TOO_DEEP = ("--keep", "final:kinetic_energy", "--output", "x/" * 2000)
"""Options of a sweep into too many folders."""


def option_cases() -> Iterator[Refused]:
    """Command lines with options that are empty, impossible or too much."""
    long = "x" * 5000
    for arguments, message in (
        (("run", "scene.json", "--engines", ""), "the argument after '--engines' is empty"),
        (("run", "scene.json", "--engines="), "--engines is empty"),
        (("run", ""), "the argument after 'run' is empty"),
        (("run", "scene.json", "--output", ""), "the argument after '--output' is empty"),
        (("run", "scene.json", "--save="), "--save is empty"),
        (("stress", "--only", ""), "the argument after '--only' is empty"),
        (("report", ""), "the argument after 'report' is empty"),
        (("regress", ""), "the argument after 'regress' is empty"),
        (("", "scene.json"), "the argument after 'crosscheck' is empty"),
        (("bench", "--error", "1e-300"), "--error is 1e-300; needed: 1e-13 or more"),
        (("run", "scene.json", "--set", "velocities=0"), "velocities is '0'; needed: a positive number"),
        (("run", "scene.json", "--set", "velocities=-1"), "velocities is '-1'; needed: a positive number"),
        (("run", "scene.json", "--set", "time=nan"), "time is 'nan'; needed: a positive number"),
        (("run", "scene.json", "--set", "time=1_0"), "time is '1_0'; needed: a positive number"),
        (("run", "scene.json", "--set", "memory=much"), "memory is 'much'; needed: a positive number"),
        (("run", "scene.json", "--set", "time=1", "--set", "time=2"), "--set time is given twice"),
        (
            ("run", "scene.json", "--set", "velocities=2"),
            "4 velocities, at most 2; to allow it: --set velocities=4",
        ),
        (("run", "tracker", "--set", "closures=1"), "scene 'tracker': 2 closures, at most 1"),
        (("run", long), "File name too long"),
        (("run", f"{long}.json"), "File name too long"),
        (("run", f"{long}.xml"), "File name too long"),
        (("run", f"{long}.urdf"), "File name too long"),
        (("run", "scene.json", "--output", long), "File name too long"),
        (("run", "scene.json", "--save", f"{long}.rrd"), "File name too long"),
        (("report", long), "File name too long"),
        (("view", long), "File name too long"),
        (("convert", "scene.json", f"{long}.yaml"), "File name too long"),
        (("regress", "pendulum", "--baseline", long), "no baseline"),
        (("bench", "--batch", "10000000"), "--batch 10000000: poses of two outputs already take more than"),
        (("bench", "--batch", "1e9"), "'1e9' is not a valid"),
        (("run", "four_bar", "--set", "N=1000"), "2002 bodies, at most 2000; to allow it: --set bodies=2002"),
        (("run", "four_bar", "--set", "N=1e3"), "N of scene 'four_bar' is '1e3'; choose a whole number"),
        (("run", "chain", "--set", "N=1000"), "1000 velocities, at most 300; to allow it: --set velocities"),
        (("run", "scene.json", "--output", "/dev/null"), "cannot write /dev/null/newton_euler.npz"),
        (("run", "scene.json", "--output", "/proc/x"), "cannot write /proc/x/newton_euler.npz"),
        (("run", "scene.json", "--output", "model.xml/out"), "Not a directory"),
        (("run", "scene.json", "--save", "x.txt"), "--save x.txt: a recording's name ends in .rrd"),
        (("run", "\udcff.xml"), "\\udcff.xml: cannot be read"),
        (("run", "model.xml", "--set", "excitation=maybe"), "excitation is 'maybe'; needed: on or off"),
        (("run", "model.xml", "--set", "root=model.xml"), "leads outside of"),
        (("run", "robot.urdf", "--set", "duration=1e-300"), "duration is 1e-300 s; needed: at least 1e-06 s"),
        (("run", "model.xml", "--set", "duration=1_0"), "duration is '1_0'; needed: a positive number"),
        (("run", "model.xml", "--set", "duration=١"), "duration is '١'; needed: a positive number"),
        (("run", "robot.urdf", "--set", "gravity=0,0,1_0"), "gravity is '0,0,1_0'; needed: X,Y,Z"),
        (("run", "robot.urdf", "--set", "gravity=down"), "gravity is 'down'; needed: X,Y,Z"),
        (("run", "robot.urdf", "--set", "gravity=1e300,0,0"), "gravity"),
        (("convert", "scene.json", "scene.json"), "would overwrite the input file scene.json"),
        (("faults", "scene.json", "--engines", "x"), "unknown engine 'x'; choose from: newton_euler, "),
        (("faults", "scene.json", "--reading"), "--reading needs an MJCF or a URDF"),
        (("stress", "--only", "zz"), "z"),
        (("figures", "--output", "model.xml"), "cannot write model.xml/figure_5.png"),
        (("view", "/dev/zero"), "/dev/zero is not a file"),
        (("view", "model.xml"), "model.xml is not a Rerun recording"),
        (
            ("regress", "scene.json", "--update", "x", "--baseline", "scene.json"),
            "scene.json: scene: ",
        ),
        (("run", "new/summary.json", "--output", "new"), "new/summary.json: cannot be read"),
        (("regress", "scene.json", "--update", "\udcff"), "--update: the reason '\\udcff' is not text"),
        (("run", "scene.json", "--output", "x/" * 2000 + "y"), "folders inside of each other"),
        (
            ("sweep", "scene.json", "--vary", "crank.mass=normal(1, 0.1)", "--runs", "2", *SWEEP_TOO_DEEP),
            "folders inside of each other",
        ),
    ):
        name = " ".join(f"{argument[:40]}{argument[40:][-5:]}" for argument in arguments)
        yield Refused(f"options {name}", arguments, message, nothing)
    stored = Path(__file__).parents[2] / "crosscheck" / "regress" / "baselines" / "pendulum.json"
    yield Refused(
        "a report over the baseline",
        ("regress", "pendulum", "--baseline", "regress.json", "--output", "."),
        "would overwrite the input file regress.json",
        written("regress.json", stored.read_text()),
    )
    for name, command in {
        "summary.json": ("run",),
        "rhs.json": ("bench", "--rhs"),
        "batch.json": ("bench", "--batch", "2"),
        "faults.json": ("faults",),
    }.items():
        yield Refused(
            f"results over {name}",
            (command[0], name, *command[1:], "--output", "."),
            f"would overwrite the input file {name}",
            written(name, TEXTS["scene.json"]),
        )
