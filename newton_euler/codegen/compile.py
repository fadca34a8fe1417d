"""Compile programs (pruned expression graphs) to native functions y = f(x), through LLVM, cached on disk.

Programs are *traced*: Python evaluates f once with symbols, which record the operations as a graph.
`NativeFunction` is the compiled function. `NativeModule` compiles LLVM's text form by llvmlite, or loads the
machine code from the cache. The text is written directly, because a compiler for general Python, such as
Numba, takes about twenty times longer for long straight-line code. The cache key contains the text or what it
depends on, the versions of all tools, and the processor.

Code can take several inputs at once, one in each *lane* (element) of the processor's vector registers.
"""

from __future__ import annotations

import ctypes
import gc
import json
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from newton_euler.codegen.cache import cache_key, read_cache, write_cache
from newton_euler.codegen.emit import emit_straight, with_callees
from newton_euler.codegen.expression import Program
from newton_euler.codegen.native import Signature
from newton_euler.codegen.rolled import emit_rolled
from newton_euler.codegen.trigonometry import REGISTER_DOUBLES
from newton_euler.scalars import Array

MIN_ROLLED_SIZE = 9_500
"""Number of operations from which on a program is compiled as loops over repeated pieces
(`newton_euler.codegen.rolled`). Straight-line code of this size would run twice as fast and take four times
as long to compile."""

MIN_ROLLED_SIZE_IN_LANES = 6 * MIN_ROLLED_SIZE
"""Number of operations below which programs that take one state of each of several runs are straight-line
code (`Traced.straight`), such as the equations of motion. Straight-line code of this size compiles in 8 s."""

CODE_LEVEL, ROLLED_CODE_LEVEL = 1, 0
"""LLVM's code generation levels for straight-line code and for rolled code.

Level 2, the default of LLVM, makes the same code in a sixth more time. Level 0 compiles ten times as fast as
level 1, and its straight-line code takes twice as long to run."""

DESCRIPTION_NAME = "f.description"
"""Name of the constant in a compiled module that holds the attributes of its `NativeFunction` as JSON.

Code from the cache has these attributes, too."""

PROGRAM_SIGNATURE = Signature({"x": "ptr", "y": "ptr", "on": "i64"}, "void")
"""Signature of every compiled program: `f(x, y, on)` reads the inputs x and writes the outputs y.

Bit i of `on` is 1 if lane i shall write its y."""

C_FUNCTION = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64)
"""Type of `ctypes` for functions with the signature `PROGRAM_SIGNATURE`."""


@lru_cache
def llvm_binding() -> Any:
    """Return llvmlite's interface to LLVM, initialized to compile for this machine."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm


@cache
def lane_count() -> int:
    """Return the number of runs that are integrated at once: the doubles in the processor's vector register.

    `REGISTER_DOUBLES` is the number for 256-bit registers; AVX-512 has registers of twice the size. More
    lanes would not be faster: the code would no longer fit into the processor's instruction cache.
    """
    return 2 * REGISTER_DOUBLES if llvm_binding().get_host_cpu_features().get("avx512f") else REGISTER_DOUBLES


@contextmanager
def garbage_collection_off() -> Iterator[None]:
    """Turn garbage collection off for a block that makes hundreds of thousands of objects without cycles."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


class NativeModule:
    """Machine code of one or more functions in memory, valid as long as this object lives.

    Attributes:
        from_cache: True if the machine code was loaded from the cache on disk.
        addresses: address of each function, by name.
    """

    def __init__(
        self,
        identity: str,
        text: Callable[[], tuple[str, int]],
        functions: Mapping[str, Signature],
        optimize: bool = False,
    ) -> None:
        """Compile LLVM text, or load its machine code from the cache.

        Args:
            identity: text that identifies the code in the cache: the LLVM text, or all that it depends on.
            text: returns the LLVM text and LLVM's code generation level for it; not called if the code is in
                the cache.
            functions: signature by name of each function that may be called by its address.
            optimize: True to move variables from memory to registers. Traced programs have no variables.
        """
        llvm = llvm_binding()
        processor, features = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
        compiler_source = Path(__file__).read_text(encoding="utf-8")
        versions = (compiler_source, optimize, llvm.llvm_version_info, sys.version, processor, features)
        key = cache_key(identity, *versions)
        code = read_cache(key)
        self.from_cache = code is not None
        target = llvm.Target.from_default_triple()
        machine_of = partial(target.create_target_machine, cpu=processor, features=features)
        # compile the text
        if code is None:
            with garbage_collection_off():
                llvm_text, level = text()
            module, machine = llvm.parse_assembly(llvm_text), machine_of(opt=level)
            if optimize:
                # LLVM's default optimization passes take ten times as long, and the code is not faster
                passes = llvm.create_new_module_pass_manager()
                passes.add_sroa_pass()
                passes.add_simplify_cfg_pass()
                passes.add_instruction_combine_pass()
                passes.run(module, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options()))
            code = machine.emit_object(module)
            write_cache(key, code)
        # load the machine code into an engine that begins with an empty module
        self._engine: Any = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine_of())
        self._engine.add_object_file(llvm.ObjectFileRef.from_data(code))
        self._engine.finalize_object()
        self.addresses = {name: int(self._engine.get_function_address(name)) for name in functions}

    def constant(self, name: str) -> bytes:
        """Return the text of a named constant of the module, which a zero byte ends in memory."""
        return ctypes.string_at(int(self._engine.get_global_value_address(name)))


class Traced(NamedTuple):
    """A traced program, and how to compile it.

    Attributes:
        program: operations, from `Graph.prune`.
        many: True for code that takes several x at once, one in each lane.
        layout: description of the results for callers, anything that JSON can hold.
        straight: True for straight-line code even if the program has `MIN_ROLLED_SIZE` operations or more.
            Results are bitwise those of rolled code: both then fuse no multiplications and additions.
        lanes: number of lanes if `many` is True.
    """

    program: Program
    many: bool = False
    layout: Any = None
    straight: bool = False
    lanes: int = REGISTER_DOUBLES


class NativeFunction:
    """A compiled function y = f(x).

    Attributes:
        inputs, outputs: lengths of x and y.
        lanes: number of inputs x that one call takes. Element i of all lanes is contiguous in memory.
        operation_count: number of floating-point operations of the program.
        layout: description of the results, see `Traced`.
        address: address of the function `void f(double *x, double *y, int64_t on)`, for native callers.
        module: compiled module that contains the function.
    """

    def __init__(self, trace: Callable[[], Traced], identity: str | None = None) -> None:
        """Compile a program, or load its code from the cache.

        Programs of `MIN_ROLLED_SIZE` operations or more become loops over repeated pieces, except those with
        `Traced.straight`. All others become straight-line code.

        Args:
            trace: returns the program; not called if its code is in the cache.
            identity: text that identifies the program in the cache. None to use its LLVM text; then the
                program is always traced.
        """

        @cache
        def text() -> tuple[str, int]:
            """Return the LLVM text of the program and LLVM's code generation level."""
            traced = trace()
            program, many, layout = traced.program, traced.many, traced.layout
            straight = traced.straight or program.operation_count < MIN_ROLLED_SIZE
            lanes = traced.lanes if many else 1
            if straight:
                body = emit_straight(program, "f", lanes, fuses=program.operation_count < MIN_ROLLED_SIZE)
            else:
                body = emit_rolled(program, "f", lanes)
            description = program.inputs, len(program.outputs), lanes, program.operation_count, layout
            # with the functions that the body calls, such as sines and cosines in lanes
            llvm_text = with_callees(body, lanes) + _constant(DESCRIPTION_NAME, json.dumps(description))
            return llvm_text, CODE_LEVEL if straight else ROLLED_CODE_LEVEL

        limits = MIN_ROLLED_SIZE, MIN_ROLLED_SIZE_IN_LANES, REGISTER_DOUBLES, lane_count()
        full_identity = f"{identity} {limits}" if identity else text()[0]
        self.module = NativeModule(full_identity, text, {"f": PROGRAM_SIGNATURE})
        description = json.loads(self.module.constant(DESCRIPTION_NAME))
        self.inputs, self.outputs, self.lanes, self.operation_count, self.layout = description
        self.address = self.module.addresses["f"]
        self._call = C_FUNCTION(self.address)

    def __call__(self, x: Array) -> Array:
        """Evaluate y (outputs,) for x (inputs,), or y (outputs, lanes) for x (inputs, lanes).

        Raises:
            ValueError: if x has another shape.
        """
        x = np.asarray(x, dtype=float)
        if x.shape not in ((self.inputs,), (self.inputs, self.lanes)):
            needed = f"{(self.inputs,)} or {(self.inputs, self.lanes)}"
            raise ValueError(f"got inputs of shape {x.shape}; needed: {needed}")
        # a single x goes to all lanes; all lanes write y (bit mask -1)
        x_in_lanes = np.repeat(x, self.lanes) if x.ndim == 1 else np.ascontiguousarray(x)
        y = np.empty((self.outputs, self.lanes))
        self._call(x_in_lanes.ctypes.data, y.ctypes.data, -1)
        return y[:, 0].copy() if x.ndim == 1 else y


def _constant(name: str, text: str) -> str:
    """Return the LLVM text of a named constant that holds an ASCII text and a zero byte at its end."""
    content = "".join(f"\\{byte:02X}" for byte in text.encode() + b"\0")
    return f'\n@{name} = constant [{len(text) + 1} x i8] c"{content}"\n'
