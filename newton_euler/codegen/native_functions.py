"""Native functions compiled together, to be called from Python."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path
from typing import Any

from newton_euler.codegen import translate
from newton_euler.codegen.compile import LEVEL, NativeModule
from newton_euler.codegen.fingerprint import SOURCE
from newton_euler.codegen.native import (
    Kind,
    NativeError,
    Signature,
    address_of,
    signature_of,
)

DECLARATIONS = """
declare double @llvm.fabs.f64(double)
declare double @llvm.sqrt.f64(double)
declare double @llvm.minnum.f64(double, double)
declare double @llvm.maxnum.f64(double, double)
declare double @llvm.pow.f64(double, double)
declare double @llvm.fmuladd.f64(double, double, double)
"""


class NativeFunctions:
    """Native functions compiled together, to be called with numbers and arrays from Python."""

    def __init__(self, functions: list[Callable[..., Any]], side_by_side: bool = False) -> None:
        """Compile them, for one run or for several side by side, see `newton_euler.codegen.lanes`."""
        written = text
        if side_by_side:
            from newton_euler.codegen.lanes import text_of as written  # asks for the processor: 0.1 s
        signatures = {function.__name__: signature_of(function) for function in functions}
        files = sorted({function.__code__.co_filename for function in functions})  # of users, perhaps
        texts = [Path(file).read_text(encoding="utf-8") for file in files]
        identity = "\n".join([SOURCE.hex(), written.__name__, *signatures, *texts])
        self.module = NativeModule(identity, lambda: (written(functions), LEVEL), signatures, optimize=True)
        self._calls = {
            name: _ctypes(signature)(self.module.addresses[name]) for name, signature in signatures.items()
        }

    def bind(self, function: Callable[..., Any], *arguments: Any) -> Callable[..., Any]:
        """Bind one of the functions to these arguments, arrays and native functions by address.

        Each call gives what is missing of them.
        """
        call, given = self._calls[function.__name__], [address_of(argument) for argument in arguments]

        def bound(*more: Any, keep: tuple[Any, ...] = arguments) -> Any:  # what has an address stays alive
            return call(*given, *map(address_of, more))

        return bound

    def __call__(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call one of the functions."""
        return self.bind(function, *arguments)()


def _ctypes(signature: Signature) -> Any:
    kinds: dict[Kind, Any] = {"double": ctypes.c_double, "i64": ctypes.c_int64, "void": None}
    arguments = [kinds.get(kind, ctypes.c_void_p) for kind in signature.arguments.values()]
    return ctypes.CFUNCTYPE(kinds[signature.result], *arguments)


def text(functions: list[Callable[..., Any]]) -> str:
    """Translate these native functions and all they call to LLVM text."""
    done: dict[str, str] = {}
    owners: dict[str, Callable[..., Any]] = {}
    entries = [function.__name__ for function in functions]
    tables: dict[str, str] = {}
    waiting = list(functions)
    while waiting:
        function = waiting.pop()
        known = owners.setdefault(function.__name__, function)
        if known is not function:
            raise NativeError(f"two functions are called {function.__name__}")
        if function.__name__ not in done:
            translator = translate.Translator(function)
            inner = function.__name__ not in entries
            done[function.__name__] = translator.translate("internal " if inner else "")
            for name, table in translator.tables.items():
                if tables.setdefault(name, table) != table:
                    raise NativeError(f"two tables are called {name}")
            waiting.extend(translator.callees)
    return "\n".join([DECLARATIONS, *tables.values(), *done.values()])
