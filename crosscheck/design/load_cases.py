"""Load cases of the command `loads`: their names and options, which must differ from case to case."""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import combinations

from crosscheck.library import LOAD_CASES, SCENES, option_values
from crosscheck.library.model_files import is_model_file, name_and_options
from crosscheck.library.options import options_of
from crosscheck.support.errors import CrosscheckError

CASE_NAME = re.compile(r"[A-Za-z0-9_.\-]+")
"""Allowed names of load cases."""

UNNAMED_CASE = "run"
"""Name of the only case if the user names no case."""


def parse_cases(given: tuple[str, ...], source: str) -> dict[str, tuple[str, ...]]:
    """Parse texts `NAME:OPTION=VALUE,OPTION=VALUE` of load cases.

    Args:
        given: the texts.
        source: name or file of the model, for messages.

    Returns:
        The settings (`OPTION=VALUE`, ...) of each case, by the name of the case. Without texts there is one
        case, `UNNAMED_CASE`, without settings.

    Raises:
        CrosscheckError: naming the case at fault: a name of another form, a name given twice, and a case
            without options, which would run the default scene under a name of its own.
    """
    cases: dict[str, tuple[str, ...]] = {}
    for case in given:
        name, _, settings = case.partition(":")
        if not CASE_NAME.fullmatch(name):
            needed = "letters, digits, _, . and - before the colon"
            raise CrosscheckError(f"--case {case!r} is not of the form NAME:OPTION=VALUE; needed: {needed}")
        if name in cases:
            raise CrosscheckError(f"--case {name} is given twice")
        cases[name] = tuple(filter(None, settings.split(",")))
    for name, own in cases.items():
        if not own:
            raise CrosscheckError(f"--case {name} has no options; needed: {name}:{_valid_options(source)}")
    return cases or {UNNAMED_CASE: ()}


def default_cases(source: str) -> dict[str, dict[str, str]]:
    """Return the options of the cases that a scene of the library has by default, by the name of the case.

    Other models have one case, `UNNAMED_CASE`, without options.
    """
    return {name: dict(options) for name, options in LOAD_CASES.get(source, {UNNAMED_CASE: {}}).items()}


def check_distinct(source: str, cases: Mapping[str, dict[str, str]]) -> None:
    """Raise `CrosscheckError` for two cases with the same values of all options.

    Args:
        source: name or file of the model.
        cases: options of each case, by the name of the case.
    """
    values = {name: option_values(source, options) for name, options in cases.items()}
    for first, second in combinations(values, 2):
        if values[first] == values[second]:
            same = f"--case {second} has the same options as {first}"
            raise CrosscheckError(f"{same}; needed: {second}:{_valid_options(source)}")


def _valid_options(source: str) -> str:
    """List the options of a model for messages, as `OPTION=VALUES,...`."""
    if source in SCENES:
        known = {name: str(option) for name, option in options_of(SCENES[source]).items()}
    elif is_model_file(source):
        known = dict.fromkeys(name_and_options(source)[1], "...")
    else:
        known = {}
    if not known:
        return f"OPTION=VALUE, but {source} has no options"
    return "OPTION=VALUE,... with the options " + ", ".join(f"{name}={text}" for name, text in known.items())
