"""Compilation of programs to native code, through LLVM, cached on disk.

llvmlite takes LLVM's own text form, which straight-line code is easily written in; a front end that
has to understand Python takes some twenty times longer for it. Machine code is kept under the user's
cache directory by a hash of that text, of the versions and of the processor.
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
from newton_euler.codegen.trigonometry import REGISTER
from newton_euler.scalars import Array

LARGE = 9_500
"""Operations from which on a program is rolled up into loops: written out it would run twice as fast and
take four times as long to compile."""

VERY_LARGE = 6 * LARGE
"""Size from which a program in lanes is rolled; a program of that size compiles for 8 s if it is written
out."""

LEVEL, QUICK_LEVEL = 1, 0
"""LLVM's levels of code generation, of straight-line and of rolled code: 2, its default, makes the same code
in a sixth more time; 0 is ten times as fast as 1, and its straight-line code takes twice as long to run."""

DESCRIPTION = "f.description"
"""Constant beside the function that a program becomes: the attributes of `NativeFunction`, as JSON."""

PROGRAM = Signature({"x": "ptr", "y": "ptr", "on": "i64"}, "void")
"""Signature of the function `f` that a program becomes; `on` are the lanes whose y is wanted, as bits."""

CALLBACK = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64)
"""C's type of such a function."""


@lru_cache
def llvm_binding() -> Any:
    """LLVM's binding, ready to compile for this machine."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm


@cache
def lane_count() -> int:
    """Return how many runs go side by side: as many as there are doubles in a vector register.

    Two registers for each number would be no quicker: their code, twice as much, leaves the cache of
    instructions.
    """
    return 2 * REGISTER if llvm_binding().get_host_cpu_features().get("avx512f") else REGISTER


@contextmanager
def uncollected() -> Iterator[None]:
    """Keep Python from looking for cycles among hundreds of thousands of new objects, which hold none."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


class NativeModule:
    """Functions compiled together, alive as long as this object is.

    Attributes:
        from_cache: True if the machine code was on disk when this was made.
        addresses: of the functions, by name.
    """

    def __init__(
        self,
        identity: str,
        text: Callable[[], tuple[str, int]],
        functions: Mapping[str, Signature],
        optimize: bool = False,
    ) -> None:
        """Compile LLVM text, or take its machine code from the cache.

        Args:
            identity: all that the text depends on, or the text itself.
            text: makes the text, and chooses LLVM's level of code generation for it.
            functions: signatures of the functions that others call, by name.
            optimize: for code with variables, which are to live in registers; a program has none.
        """
        llvm = llvm_binding()
        processor, features = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
        made_by = Path(__file__).read_text(encoding="utf-8")
        versions = (made_by, optimize, llvm.llvm_version_info, sys.version, processor, features)
        key = cache_key(identity, *versions)
        code = read_cache(key)
        self.from_cache = code is not None
        target = llvm.Target.from_default_triple()
        machine_of = partial(target.create_target_machine, cpu=processor, features=features)
        if code is None:
            with uncollected():
                written, level = text()
            module, machine = llvm.parse_assembly(written), machine_of(opt=level)
            if optimize:
                # LLVM's own selection of passes takes ten times as long and gains nothing
                passes = llvm.create_new_module_pass_manager()
                passes.add_sroa_pass()
                passes.add_simplify_cfg_pass()
                passes.add_instruction_combine_pass()
                passes.run(module, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options()))
            code = machine.emit_object(module)
            write_cache(key, code)
        self._engine: Any = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine_of())
        self._engine.add_object_file(llvm.ObjectFileRef.from_data(code))
        self._engine.finalize_object()
        self.addresses = {name: int(self._engine.get_function_address(name)) for name in functions}

    def constant(self, name: str) -> bytes:
        """Return a constant of the module, text that ends with a zero byte."""
        return ctypes.string_at(int(self._engine.get_global_value_address(name)))


class Traced(NamedTuple):
    """A program to compile.

    Attributes:
        program: its operations.
        many: True for code that takes several x at once, as many as there are `lanes`.
        layout: where the program has its results, for callers: anything that JSON can hold.
        straight: True for straight-line code, whatever its size; results are those of rolled code.
    """

    program: Program
    many: bool = False
    layout: Any = None
    straight: bool = False
    lanes: int = REGISTER


class NativeFunction:
    """`y = f(x)` in native code.

    Attributes:
        inputs, outputs: lengths of x and y.
        lanes: number of x that are taken at once, values of all of them side by side; as many y are made.
        operations: floating-point operations of the program.
        layout: as of `Traced`.
        address: of `void f(double *x, double *y, int64_t on)`, for native callers.
        module: the compiled module that it is in.
    """

    def __init__(self, trace: Callable[[], Traced], identity: str | None = None) -> None:
        """Compile a program: straight-line code, or loops over repeated pieces if it is `LARGE`.

        Args:
            trace: makes the program, unless its code is in the cache.
            identity: all that the program depends on, and this package; its text if None.
        """

        @cache
        def text() -> tuple[str, int]:
            traced = trace()
            program, many, layout = traced.program, traced.many, traced.layout
            straight = traced.straight or program.operations < LARGE
            lanes = traced.lanes if many else 1
            if straight:
                body = emit_straight(program, "f", lanes, fuses=program.operations < LARGE)
            else:
                body = emit_rolled(program, "f", lanes)
            description = program.inputs, len(program.outputs), lanes, program.operations, layout
            written = with_callees(body, lanes) + _constant(DESCRIPTION, json.dumps(description))
            return written, LEVEL if straight else QUICK_LEVEL

        limits = LARGE, VERY_LARGE, REGISTER, lane_count()
        known = f"{identity} {limits}" if identity else text()[0]
        self.module = NativeModule(known, text, {"f": PROGRAM})
        description = json.loads(self.module.constant(DESCRIPTION))
        self.inputs, self.outputs, self.lanes, self.operations, self.layout = description
        self.address = self.module.addresses["f"]
        self._call = CALLBACK(self.address)

    def __call__(self, x: Array) -> Array:
        """y (outputs,) for x (inputs,), which all lanes get, or y (outputs, lanes) for x (inputs, lanes)."""
        x = np.asarray(x, dtype=float)
        if x.shape not in ((self.inputs,), (self.inputs, self.lanes)):
            needed = f"{(self.inputs,)} or {(self.inputs, self.lanes)}"
            raise ValueError(f"got inputs of shape {x.shape}; needed: {needed}")
        given = np.repeat(x, self.lanes) if x.ndim == 1 else np.ascontiguousarray(x)
        y = np.empty((self.outputs, self.lanes))
        self._call(given.ctypes.data, y.ctypes.data, -1)
        return y[:, 0].copy() if x.ndim == 1 else y


def _constant(name: str, text: str) -> str:
    """Give ASCII text as LLVM's text of a constant that ends with a zero byte."""
    content = "".join(f"\\{byte:02X}" for byte in text.encode() + b"\0")
    return f'\n@{name} = constant [{len(text) + 1} x i8] c"{content}"\n'
