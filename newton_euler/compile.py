"""Programs to native code, through LLVM, cached on disk.

llvmlite takes LLVM's own text form, which straight-line code is easily written in; a front end that
has to understand Python takes some twenty times longer for it. Machine code is kept under the user's
cache directory by a hash of that text, of the versions and of the processor. A cache that cannot be
read or written costs a compilation, never a run.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from newton_euler.expression import Program
from newton_euler.scalars import Array

CACHE_VARIABLE = "NEWTON_EULER_CACHE"
"""Environment variable that names the cache directory; empty for no cache."""

_ARITHMETIC = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
_INTRINSICS = {
    "sqrt": "llvm.sqrt.f64",
    "sin": "llvm.sin.f64",
    "cos": "llvm.cos.f64",
    "minimum": "llvm.minnum.f64",
}

DECLARATIONS = """
declare double @llvm.sqrt.f64(double)
declare double @llvm.sin.f64(double)
declare double @llvm.cos.f64(double)
declare double @llvm.minnum.f64(double, double)
declare double @atan2(double, double)
"""


def emit(program: Program, name: str) -> str:
    """LLVM text of `void name(double *x, double *y)`: y = the program's outputs at inputs x.

    Products may be contracted with sums into one rounding (`contract`), nothing else is reordered.
    """
    lines = [f"define void @{name}(ptr noalias nocapture readonly %x, ptr noalias nocapture %y) {{"]
    values: list[str] = []
    for k, (op, a, b) in enumerate(program.nodes):
        if op == "const":
            values.append(literal(a))
            continue
        values.append(f"%n{k}")
        if op == "input":
            lines.append(f"  %a{k} = getelementptr double, ptr %x, i64 {a}")
            lines.append(f"  %n{k} = load double, ptr %a{k}")
        elif op in _ARITHMETIC:
            lines.append(f"  %n{k} = {_ARITHMETIC[op]} contract double {values[a]}, {values[b]}")
        elif op == "neg":
            lines.append(f"  %n{k} = fneg double {values[a]}")
        elif op == "arctan2":
            lines.append(f"  %n{k} = call double @atan2(double {values[a]}, double {values[b]})")
        else:
            second = f", double {values[b]}" if b >= 0 else ""
            lines.append(f"  %n{k} = call double @{_INTRINSICS[op]}(double {values[a]}{second})")
    for k, output in enumerate(program.outputs):
        lines.append(f"  %b{k} = getelementptr double, ptr %y, i64 {k}")
        lines.append(f"  store double {values[output]}, ptr %b{k}")
    lines.append("  ret void\n}")
    return "\n".join(lines)


def literal(value: float) -> str:
    """A double in LLVM's hexadecimal form, exact."""
    return f"0x{int(np.float64(value).view(np.uint64)):016X}"


class NativeModule:
    """Functions compiled together, alive as long as this object is."""

    def __init__(self, text: str, level: int = 2) -> None:
        """Compile LLVM text, or take its machine code from the cache; `level` is LLVM's -O."""
        import llvmlite.binding as llvm

        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        processor, features = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
        machine = llvm.Target.from_default_triple().create_target_machine(
            cpu=processor, features=features, opt=level
        )
        versions = (str(level), llvm.llvm_version_info, sys.version, processor, features)
        key = hashlib.sha256("\n".join([text, *map(str, versions)]).encode()).hexdigest()
        code = _read_cache(key)
        self.from_cache = code is not None
        if code is None:
            module = llvm.parse_assembly(text)
            module.verify()
            options = llvm.create_pipeline_tuning_options(speed_level=level)
            options.slp_vectorization = options.loop_vectorization = False
            builder = llvm.create_pass_builder(machine, options)
            builder.getModulePassManager().run(module, builder)
            code = machine.emit_object(module)
            _write_cache(key, code)
        self.size = len(code)
        self._engine: Any = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
        self._engine.add_object_file(llvm.ObjectFileRef.from_data(code))
        self._engine.finalize_object()

    def address(self, name: str) -> int:
        """Where a function is."""
        return int(self._engine.get_function_address(name))


class NativeFunction:
    """`y = f(x)` in native code.

    Attributes:
        inputs, outputs: lengths of x and y.
        address: of `void f(double *x, double *y)`, for native callers.
    """

    def __init__(self, module: NativeModule, name: str, program: Program) -> None:
        self.inputs, self.outputs = program.inputs, len(program.outputs)
        self.address = module.address(name)
        self._module = module  # keeps the code alive
        self._call = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)(self.address)

    def __call__(self, x: Array) -> Array:
        """(outputs,) for x (inputs,)."""
        x = np.ascontiguousarray(x, dtype=float)
        if x.shape != (self.inputs,):
            raise ValueError(f"got inputs of shape {x.shape}; needed: ({self.inputs},)")
        y = np.empty(self.outputs)
        self._call(x.ctypes.data, y.ctypes.data)
        return y


def compile_programs(programs: dict[str, Program]) -> dict[str, NativeFunction]:
    """Compile programs into one module."""
    text = "\n".join([DECLARATIONS, *(emit(program, name) for name, program in programs.items())])
    module = NativeModule(text)
    return {name: NativeFunction(module, name, program) for name, program in programs.items()}


# The cache: a file holds its own SHA-256 and then machine code.


def cache_directory() -> Path | None:
    """Where machine code is kept; None if the user wants no cache."""
    chosen = os.environ.get(CACHE_VARIABLE)
    if chosen is not None:
        return Path(chosen) if chosen else None
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "newton_euler"


def _read_cache(key: str) -> bytes | None:
    directory = cache_directory()
    if directory is None:
        return None
    try:
        content = (directory / key).read_bytes()
    except OSError:
        return None
    digest, code = content[:32], content[32:]
    return code if hashlib.sha256(code).digest() == digest else None


def _write_cache(key: str, code: bytes) -> None:
    """Keep machine code; written beside and renamed, so that no reader ever sees half of it."""
    directory = cache_directory()
    if directory is None:
        return
    try:
        directory.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=directory, prefix=".new-")
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(hashlib.sha256(code).digest() + code)
            Path(name).replace(directory / key)
        except OSError:
            _remove([Path(name)])
    except OSError:
        pass  # a full or read-only disk: the next run compiles again


def _remove(paths: Iterable[Path]) -> None:
    for path in paths:
        path.unlink(missing_ok=True)
