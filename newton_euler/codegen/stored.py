"""Traced programs and constraint rows as text, to be kept in the cache: data, which nothing can run."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from newton_euler.codegen.expression import BINARY, UNARY, Node, Program
from newton_euler.equations.redundancy import NearlyRedundant
from newton_euler.equations.sparse import RowsInUse

OPERATIONS = {*BINARY, *UNARY, "const", "input"}


def program_text(program: Program, layout: Any) -> str:
    """A program and its layout, see `Code.layouts`, as JSON."""
    ops, a, b = zip(*program.nodes, strict=True) if program.nodes else ((), (), ())
    places: Any = None
    if isinstance(layout, dict):
        places = {name: [place.start, place.stop, shape] for name, (place, shape) in layout.items()}
    elif layout is not None:
        places = [array.tolist() for array in layout]
    return json.dumps([ops, a, b, program.inputs, program.outputs, places])


def read_program(text: bytes) -> tuple[Program, Any]:
    """What `program_text` made; raises `ValueError` for anything else."""
    try:
        ops, a, b, inputs, outputs, places = json.loads(text)
        layout: Any = None
        if isinstance(places, dict):
            layout = {
                name: (slice(start, stop), tuple(shape)) for name, (start, stop, shape) in places.items()
            }
        elif places is not None:
            layout = tuple(np.array(array, dtype=int).reshape(-1, 2) for array in places)
        if not OPERATIONS.issuperset(ops):
            raise ValueError(f"unknown operations {sorted(set(ops) - OPERATIONS)}")
        return Program(tuple(map(Node, ops, a, b)), inputs, tuple(outputs)), layout
    except (TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f"no program: {error}") from error


def rows_text(found: tuple[RowsInUse, bool, tuple[NearlyRedundant, ...]]) -> str:
    """Rows in use, whether multipliers are not unique, and what is nearly redundant, as JSON."""
    return json.dumps(found)


def read_rows(text: bytes) -> tuple[RowsInUse, bool, tuple[NearlyRedundant, ...]]:
    """What `rows_text` made; raises `ValueError` for anything else."""
    try:
        rows, redundant, nearly = json.loads(text)
        return RowsInUse(*rows), bool(redundant), tuple(NearlyRedundant(*weak) for weak in nearly)
    except (TypeError, RecursionError) as error:
        raise ValueError(f"no rows: {error}") from error
