"""Native functions compiled together, to be called from Python."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path
from typing import Any

from newton_euler.codegen.compile import LEVEL, NativeModule, lane_count
from newton_euler.codegen.fingerprint import SOURCE
from newton_euler.codegen.native import Kind, Signature, address_of, signature_of
from newton_euler.codegen.translate import text


class NativeFunctions:
    """Native functions compiled together, to be called with numbers and arrays from Python."""

    def __init__(self, functions: list[Callable[..., Any]], side_by_side: bool = False) -> None:
        """Compile them, for one run or for several side by side, see `newton_euler.codegen.translate`."""
        lanes = lane_count() if side_by_side else 1
        signatures = {function.__name__: signature_of(function) for function in functions}
        files = sorted({function.__code__.co_filename for function in functions})  # of users, perhaps
        texts = [Path(file).read_text(encoding="utf-8") for file in files]
        identity = "\n".join([SOURCE.hex(), str(lanes), *signatures, *texts])
        self.module = NativeModule(
            identity, lambda: (text(functions, lanes), LEVEL), signatures, optimize=True
        )
        self._calls = {
            name: _ctypes(signature)(self.module.addresses[name]) for name, signature in signatures.items()
        }

    def bind(self, function: Callable[..., Any], *arguments: Any) -> Callable[..., Any]:
        """Bind one of the functions to these arguments, arrays and native functions by address.

        Each call gives what is missing of them.
        """
        call, given = self._calls[function.__name__], [address_of(argument) for argument in arguments]

        # what has an address stays alive, and so does the code
        def bound(*more: Any, keep: tuple[Any, ...] = (self, *arguments)) -> Any:
            return call(*given, *map(address_of, more))

        return bound

    def __call__(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call one of the functions."""
        return self.bind(function, *arguments)()


def _ctypes(signature: Signature) -> Any:
    kinds: dict[Kind, Any] = {"double": ctypes.c_double, "i64": ctypes.c_int64, "void": None}
    arguments = [kinds.get(kind, ctypes.c_void_p) for kind in signature.arguments.values()]
    return ctypes.CFUNCTYPE(kinds[signature.result], *arguments)
