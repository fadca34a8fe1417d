"""Compile functions marked `native` (see `newton_euler.codegen.native`) and call them from Python.

Such functions are written in a simple subset of Python, for example the integrators. `NativeFunctions`
translates the functions and all functions that they call to LLVM text. It compiles the text or loads its
machine code from the cache. Its calls pass numbers, arrays and records (structures of named fields) to the
functions.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path
from typing import Any

from newton_euler.codegen.compile import CODE_LEVEL, NativeModule, lane_count
from newton_euler.codegen.fingerprint import SOURCE
from newton_euler.codegen.native import Kind, Signature, address_of, signature_of
from newton_euler.codegen.translate import text


class NativeFunctions:
    """Compiled functions that Python calls with numbers, arrays, records and other native functions.

    Attributes:
        module: machine code of the functions.
    """

    def __init__(self, functions: list[Callable[..., Any]], in_lanes: bool = False) -> None:
        """Compile functions, or load their machine code from the cache.

        Args:
            functions: functions marked `native`.
            in_lanes: True for code that makes several runs at once, one in each lane of the vector
                registers (`newton_euler.codegen.translate`).
        """
        lanes = lane_count() if in_lanes else 1
        signatures = {function.__name__: signature_of(function) for function in functions}
        # `SOURCE` is the digest of this package's files; the functions may be in files of a user
        files = sorted({function.__code__.co_filename for function in functions})
        texts = [Path(file).read_text(encoding="utf-8") for file in files]
        identity = "\n".join([SOURCE.hex(), str(lanes), *signatures, *texts])
        # the lambda returns LLVM text and LLVM's code generation level for it
        self.module = NativeModule(
            identity, lambda: (text(functions, lanes), CODE_LEVEL), signatures, optimize=True
        )
        self._calls = {
            name: _ctypes(signature)(self.module.addresses[name]) for name, signature in signatures.items()
        }

    def bind(self, function: Callable[..., Any], *arguments: Any) -> Callable[..., Any]:
        """Return a function that calls one of the functions with these first arguments.

        Args:
            function: one of the compiled functions.
            arguments: its first arguments; arrays, records and native functions are passed by address. The
                returned function takes the remaining arguments.
        """
        call, given = self._calls[function.__name__], [address_of(argument) for argument in arguments]

        # `keep` is never passed: its default value keeps alive the code, and all that was passed by address
        def bound(*more: Any, keep: tuple[Any, ...] = (self, *arguments)) -> Any:
            """Call the function with the bound arguments and these further ones."""
            return call(*given, *map(address_of, more))

        return bound

    def __call__(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call one of the functions with all its arguments, and return its result."""
        return self.bind(function, *arguments)()


def _ctypes(signature: Signature) -> Any:
    """Return the type of `ctypes` for functions of a signature; vectors and records are pointers."""
    kinds: dict[Kind, Any] = {"double": ctypes.c_double, "i64": ctypes.c_int64, "void": None}
    arguments = [kinds.get(kind, ctypes.c_void_p) for kind in signature.arguments.values()]
    return ctypes.CFUNCTYPE(kinds[signature.result], *arguments)
