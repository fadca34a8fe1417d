"""Help of the commands: all commands by task, lines of 80 columns with whole words, and examples that run."""

from __future__ import annotations

import shlex
import shutil
from pathlib import Path

import click
import numpy as np
import pytest
from command_line import run

from crosscheck.cli.help import TASKS, Command
from crosscheck.cli.shared import cli
from crosscheck.loading.load import load_scene
from newton_euler import simulate

ROOT = Path(__file__).parents[3]

NAMES = sorted(cli.commands)

MAX_OPTIONS = 10
"""Largest number of options that a help lists without groups."""

STATUSES = {
    "crosscheck diff robot.xml robot_v2.xml": 1,
    "crosscheck diff examples/arm.xml examples/arm.urdf": 1,
    "crosscheck importers robot.xml": 1,  # an importer does not read the loop
}
"""Exit statuses of examples that find a difference; those of others are 0."""


def command_of(name: str) -> Command:
    """The command of a name."""
    command = cli.commands[name]
    assert isinstance(command, Command)
    return command


def test_each_command_is_listed_below_one_task(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert sorted(name for names in TASKS.values() for name in names) == NAMES
    status, out, _ = run(capsys, "--help")
    assert status == 0
    first_words = [line.split()[0] for line in out.splitlines() if line.startswith("  ")]
    assert [word for word in first_words if word in NAMES] == [n for names in TASKS.values() for n in names]


@pytest.mark.parametrize("name", NAMES)
def test_help_has_whole_words_in_80_columns(capsys, monkeypatch, name):
    monkeypatch.setenv("COLUMNS", "80")
    status, out, _ = run(capsys, name, "--help")
    assert status == 0
    assert max(map(len, out.splitlines())) <= 80
    command = command_of(name)
    options = [each for each in command.params if isinstance(each, click.Option)]
    texts = [command.help, *command.arguments.values(), *command.examples, *(each.help for each in options)]
    assert {word for text in texts for word in str(text).split()} <= set(out.split())


@pytest.mark.parametrize("name", NAMES)
def test_arguments_have_help_and_many_options_have_groups(name):
    command = command_of(name)
    options = [each for each in command.params if isinstance(each, click.Option)]
    assert command.groups or len(options) <= MAX_OPTIONS
    usage = command.collect_usage_pieces(click.Context(command))[1:]
    assert [text.strip("[]") for text in command.arguments] == [piece.strip("[]") for piece in usage]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The working folder of the examples: a model file, another version of it, and a measured run."""
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    text = (ROOT / "examples" / "linkage.xml").read_text()
    (tmp_path / "robot.xml").write_text(text)
    assert 'density="2700"' in text
    (tmp_path / "robot_v2.xml").write_text(text.replace('density="2700"', 'density="2800"'))
    monkeypatch.chdir(tmp_path)
    measured = simulate(load_scene("robot.xml", {})[0])
    columns = np.column_stack([measured.time, measured.joint("motor").coordinates[:, 0]])
    header = "time,coordinate.motor"
    np.savetxt("run_1.csv", columns, delimiter=",", header=header, comments="")
    return tmp_path


@pytest.mark.parametrize("name", NAMES)
def test_examples_have_options_of_their_command(name):
    examples = command_of(name).examples
    assert examples
    for line in examples.values():
        program, called, *rest = shlex.split(line)
        assert (program, called) == ("crosscheck", name)
        # within the group's context: Click keeps the help option that a command was first given
        with (
            cli.make_context("crosscheck", [name, *rest]) as group,
            cli.commands[name].make_context(name, rest, parent=group),
        ):
            pass


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in NAMES if name != "view"])  # no window opens
def test_examples_run(capsys, folder, name):
    if name == "report":
        run(capsys, "modes", "pendulum")  # results for the page
    for line in command_of(name).examples.values():
        status, out, err = run(capsys, *shlex.split(line)[1:])
        assert status == STATUSES.get(line, 0), f"{line}\n{out}{err}"
