"""Native functions compiled, to be called from Python."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

from newton_euler.codegen.compile import NativeModule
from newton_euler.codegen.native import Kind, Signature, address_of, signature_of
from newton_euler.codegen.translate import sources, text


class NativeFunctions:
    """Native functions compiled together, to be called with numbers and arrays from Python."""

    def __init__(self, functions: list[Callable[..., Any]]) -> None:
        """Compile them."""
        signatures = {function.__name__: signature_of(function) for function in functions}
        identity = " ".join(signatures) + sources(functions)
        self.module = NativeModule(identity, lambda: text(functions), signatures, optimise=True)
        self._calls = {
            name: _ctypes(signature)(self.module.addresses[name]) for name, signature in signatures.items()
        }

    def bind(self, function: Callable[..., Any], *arguments: Any) -> Callable[..., Any]:
        """A call of one of the functions with these arguments, arrays and native functions by address.

        What is missing of them is for each call to give.
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
