"""Make a native function from Python code that computes with scalars, or load it from the cache on disk.

Tracing calls the code once with symbolic scalars, which record all operations; the record is compiled. A
fingerprint (hash) of all that the code depends on identifies the function in the cache.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from newton_euler.codegen.compile import MIN_ROLLED_SIZE, NativeFunction, Traced
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
    """Return a native function of x (inputs,); trace and compile it if it is not in the cache.

    Args:
        name: name of the function, which distinguishes functions of the same objects in the cache.
        inputs: length of x.
        trace: takes symbolic scalars x (inputs,) and returns the results, and a value for the attribute
            `layout` of the function, which describes the results to callers; None for no description.
        depends_on: all objects on which the results depend; their contents identify the cached code.
        neutral: names of fields of these objects that do not change the results.
        many: True for code that takes several x at once, one in each lane. A program of `MIN_ROLLED_SIZE`
            operations or more is compiled as loops over repeated pieces, and takes one x.
    """

    def traced() -> Traced:
        """Trace the function; called only if its code is not in the cache."""
        graph = Graph()
        scalars, layout = trace(graph.variables(inputs))
        program = graph.prune(scalars)
        return Traced(program, many=many and program.operation_count < MIN_ROLLED_SIZE, layout=layout)

    # the fingerprint is None for an object of a class outside newton_euler: then the code identifies the
    # function
    known = fingerprint(*depends_on, neutral=neutral)
    return NativeFunction(traced, identity=f"{known} {name}" if known else None)
