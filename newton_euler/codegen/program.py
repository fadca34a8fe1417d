"""Programs of one function: trace, fingerprint, compile, or load from the cache."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from newton_euler.codegen.compile import LARGE, NativeFunction, Traced
from newton_euler.codegen.expression import Graph
from newton_euler.codegen.fingerprint import fingerprint
from newton_euler.scalars import Array, Scalar


def native_program(
    name: str,
    inputs: int,
    trace: Callable[[Array], tuple[Sequence[Scalar], Any]],
    *depends_on: object,
    neutral: frozenset[str],
    many: bool = False,
) -> NativeFunction:
    """Return a function of x (inputs,) as native code, from the cache if the code is there.

    Args:
        name: distinguishes programs that depend on the same values.
        inputs: length of x.
        trace: computes the results over scalars x, and their layout for the attribute `layout`, or None.
        depends_on: everything that the program depends on; see `fingerprint`.
        neutral: names of fields that the program does not depend on.
        many: True to take several x at once, unless the program is large.
    """

    def traced() -> Traced:
        graph = Graph()
        scalars, layout = trace(graph.variables(inputs))
        program = graph.prune(scalars)
        return Traced(program, many and program.operations < LARGE, layout)

    known = fingerprint(*depends_on, neutral=neutral)
    return NativeFunction(traced, known and f"{known} {name}")
