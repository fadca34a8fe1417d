"""Loading machine code once in a process: scenes with equal equations share it in all tests."""

from __future__ import annotations

from collections import OrderedDict
from functools import cache
from hashlib import blake2b
from typing import Any

from newton_euler.codegen import compile as codegen

MAX_ENGINES = 300
"""Number of codes in memory, each of some 100 kB. The code that was used least recently leaves first."""

ENGINES: OrderedDict[bytes, Any] = OrderedDict()
"""Execution engines of LLVM by the digest of their code."""

llvm_binding = codegen.llvm_binding


class Engine:
    """An execution engine, shared with all others of the same code."""

    def __init__(self, *arguments: Any) -> None:
        self.arguments = arguments

    def add_object_file(self, code: bytes) -> None:
        """Load the code, unless it is loaded."""
        digest = blake2b(code).digest()
        if digest not in ENGINES:
            llvm = llvm_binding()
            engine = llvm.create_mcjit_compiler(*self.arguments)
            engine.add_object_file(llvm.ObjectFileRef.from_data(code))
            engine.finalize_object()
            ENGINES[digest] = engine
        ENGINES.move_to_end(digest)
        self.loaded = ENGINES[digest]
        if len(ENGINES) > MAX_ENGINES:
            ENGINES.popitem(last=False)

    def finalize_object(self) -> None:
        """Do nothing: the code is loaded."""

    def __getattr__(self, name: str) -> Any:
        return getattr(self.loaded, name)


class Binding:
    """The interface to LLVM with shared engines."""

    create_mcjit_compiler = Engine

    class ObjectFileRef:
        """Code as it is, whose digest `Engine` takes."""

        from_data = bytes

    def __getattr__(self, name: str) -> Any:
        return getattr(llvm_binding(), name)


@cache
def shared_binding() -> Binding:
    """Take the place of `newton_euler.codegen.compile.llvm_binding`."""
    return Binding()
